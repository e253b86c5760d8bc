"""The verb `keycld identify`."""

from pathlib import Path
from typing import Annotated

import tyro


def identify(
    log: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="LOG.csv")],
    /,
    *,
    mechanism: str,
    position: tuple[str, ...] = ("position",),
    input: tuple[str, ...] = ("torque",),
    time: str = "time",
    lengths: tuple[float, ...] = (),
    held: float = 1 / 3,
    out: Path | None = None,
    json: bool = False,
) -> None:
    """Identify a rig from a log of joint positions and torques: inertia, weight, springs, friction, with error bars.

    Args:
        log: CSV file; its first line names the columns.
        mechanism: pendulum, double-pendulum, cart-pole or spring, or a TOML file of keypoints and constraints: an open
            chain.
        position: Columns of the joint positions, from the ground outward: rad, 0 hanging down, each angle against the
            link before; metres for slides.
        input: Columns of the torques or forces of the first joints, in the same order, held from each time to the next.
        time: Column of the time in seconds; even steps.
        lengths: Lengths of the links in metres; inertias and torques do not depend on them.
        held: Share of the log at its end that is predicted from its torques and not fitted.
        out: Folder in which evaluation/physics.json is written; by default nothing is written.
        json: Print the result as JSON.
    """
    from keycld.data.imports.log import read_log
    from keycld.evaluation import as_json, identify_log, physics_table, save_physics
    from keycld.mechanics import load_constraints

    found = identify_log(
        read_log(log, position, input, time),
        load_constraints(mechanism),
        Path(mechanism).stem,
        lengths=lengths or None,
        held=held,
    )
    if out is not None:
        save_physics(out, found.physics)
    print(as_json(dict(found.physics)) if json else physics_table(found.physics))
