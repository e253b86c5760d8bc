"""`keycld demo`."""

import time
from pathlib import Path
from typing import Annotated

import tyro

from keycld._errors import unknown


def demo(
    system: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="SYSTEM")] = "pendulum",
    /,
    *,
    out: Path | None = None,
    preset: str = "fast",
    seed: int = 0,
    set: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME=VALUE ...")] = (),
) -> None:
    """Run everything on one system: data, training, evaluation, control, report.

    The pendulum takes five to ten minutes on two CPU cores, three to five of them for training.

    Args:
        system: pendulum, cartpole or acrobot.
        out: Run folder; by default runs/SYSTEM-demo.
        preset: A preset of the model keycld: fast takes minutes, control longer, paper and journal need a GPU.
        seed: Seed of the training.
        set: Settings of the preset to change, such as vision.steps=500.
    """
    from keycld.cli.control import control
    from keycld.cli.evaluate import evaluate
    from keycld.cli.making import data_for
    from keycld.cli.report import report
    from keycld.cli.settings import parse_setting
    from keycld.cli.train import train
    from keycld.models import config_for
    from keycld.systems import AbstractMujocoSystem, names

    possible = names(AbstractMujocoSystem)
    if system not in possible:
        raise unknown("system", system, possible, of="the demo")
    run = out or Path("runs") / f"{Path(system).name}-demo"
    times = {}

    def timed(name, action, *arguments, **options):
        print(f"── {name}", flush=True)
        began = time.monotonic()
        action(*arguments, **options)
        times[name] = time.monotonic() - began

    timed("data", data_for, system)
    settings = config_for("keycld", preset, **dict(parse_setting(text) for text in set))
    timed("training", train, system, settings=settings, seed=seed, out=run)
    # The long test set would take longer to make than all scores of this one.
    timed("evaluation", evaluate, str(run), protocols=("test@50",))
    # With this seed the pendulum's random initial state is near the bottom: −3.08 rad.
    timed("control", control, str(run), seed=9)
    timed("report", report, str(run))
    print("time: " + ", ".join(f"{name} {seconds:.0f} s" for name, seconds in times.items()))
    print(f"open {run / 'report.html'} in a browser; keycld eval {run} scores predictions of 200 and 500 frames too")
