"""Registers the Gymnasium environments; importing this module does not need Gymnasium."""

from keycld._errors import KeycldError


def register_environments() -> None:
    """Make `gymnasium.make("keycld/Pendulum-v0")`, `keycld/Cartpole-v0` and `keycld/Acrobot-v0` work.

    Raises:
        KeycldError: Gymnasium is not installed.
    """
    try:
        import gymnasium as gymnasium
    except ModuleNotFoundError as error:
        raise KeycldError("environments need Gymnasium: install it with pip install 'keycld[envs]'.") from error
    from keycld.control.environments import register

    register()
