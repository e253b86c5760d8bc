"""Learn the physics of a moving system from video, then predict and control it."""

from keycld._compile_cache import use_compile_cache as use_compile_cache
from keycld._errors import KeycldError as KeycldError
from keycld._version import __version__ as __version__
from keycld._xla_flags import avoid_faulty_kernels as _avoid_faulty_kernels

_avoid_faulty_kernels()


def load(run):
    """Return a trained model.

    ```python
    model = keycld.load("acrobot")
    model.law.masses, model.law.potential_energy(x)
    model.predict(frames, dt, u, length=200).frames
    ```

    Args:
        run: a run folder, or the name of a model in the package: pendulum, cartpole, acrobot.

    Raises:
        KeycldError: it is neither.
    """
    from keycld.training import load_model

    return load_model(run)[0]
