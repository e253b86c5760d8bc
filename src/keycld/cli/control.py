"""`keycld control`."""

from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from keycld import KeycldError


def control(
    run: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="RUN")],
    /,
    *,
    goal: str = "upright",
    law: Literal["shaping", "paper", "mpc", "zero", "random"] = "shaping",
    kp: float = 5.0,
    kd: float = 2.0,
    limit: float | None = None,
    actuators: tuple[str, ...] = (),
    seconds: float = 10.0,
    starts: int = 1,
    seed: int = 0,
    observer: Literal["predict-correct", "differences"] = "predict-correct",
    noise: float = 0.0,
    drop: float = 0.0,
    out: Path | None = None,
    workers: int | None = None,
) -> None:
    """Bring the simulated system to a goal from its pixels: movie, figures, trajectories, energies, inputs, timing.

    Args:
        run: Run folder, or a trained model of the package: pendulum, cartpole, acrobot.
        goal: upright, or a picture (.png) of the pose to reach, as large as the training pictures.
        law: shaping (energy shaping), paper (its eq. 15 to the letter), mpc (plans a motion and tracks it: for weak or
            missing inputs), or zero or random input to compare with.
        kp: Stiffness by mass, 1/s²; small deviations swing with √kp rad/s.
        kd: Damping by mass, 1/s.
        limit: The largest |u|; none unless told. mpc and random need one; the usual training data have 3.
        actuators: The inputs that act, by name; unless told all that moved in the training data.
        seconds: How long.
        starts: How many random starts; the first one is timed and shown.
        seed: Of starts and noise.
        observer: Where velocities come from: predict-correct (learned dynamics) or differences of frames.
        noise: Deviation of noise on the pictures, as a part of the full range.
        drop: Probability that a frame does not arrive.
        out: Folder for the results; the run's own unless told.
        workers: Processes that simulate and draw, at most four. Default: one a core.
    """
    from keycld.control import Assignment, Disturbance, known_inputs, swing_up
    from keycld.evaluation import save_evaluation
    from keycld.reports import write_control_media
    from keycld.systems import get
    from keycld.training import Counted, load_run, run_folder

    folder = run_folder(run)
    model, config = load_run(folder)
    system = get(config.system)
    assignment = Assignment(
        law=law,
        kp=kp,
        kd=kd,
        limit=limit,
        actuators=known_inputs(system.input_names, config.moved_inputs, actuators),
        seconds=seconds,
        starts=starts,
        seed=seed,
        observer=observer,
        disturbance=Disturbance(noise, drop),
    )
    picture = None if goal == "upright" else _picture(Path(goal))
    result = swing_up(
        model,
        system,
        threshold_of(model, config),
        picture,
        assignment,
        progress=Counted("control"),
        workers=workers,
    )
    target, name = out or folder, _name(goal, assignment)
    path = save_evaluation(target, name, result)
    movie, _, figure = write_control_media(target, name, result)
    print(summary_of(result.scores))
    print(f"stored: {path}, {movie}, {figure}")
    if out is None:
        print(f"next: keycld report {run}")


def _picture(path: Path) -> Any:
    import imageio.v3

    try:
        picture = imageio.v3.imread(path)
    except (OSError, ValueError) as error:
        raise KeycldError(f"--goal takes upright or a picture; '{path}' cannot be read ({error}).") from None
    return picture[..., :3] if picture.ndim == 3 else picture


def threshold_of(model: Any, config: Any) -> float:
    """ε as the model itself knows it, from the deviation of its training pictures; else from its data."""
    standardise = getattr(getattr(model, "estimator", None), "standardise", None)
    if standardise is not None:
        return float(standardise.deviation) ** 2
    from keycld.data import open_data
    from keycld.evaluation import epsilon

    return epsilon(open_data(config.data).validation().image)  # pyright: ignore[reportArgumentType]


def _name(goal: str, assignment: Any) -> str:
    """Of the result's files: goal, law, and what else differs from the defaults, starts and seed apart."""
    words = ["control", "upright" if goal == "upright" else Path(goal).stem, assignment.law]
    words += list(assignment.actuators or ())
    usual = type(assignment)()
    words += [
        f"{name}{getattr(assignment, name):g}"
        for name in ("kp", "kd", "limit", "seconds")
        if getattr(assignment, name) != getattr(usual, name)
    ]
    words += [f"noise{assignment.disturbance.noise:g}"] if assignment.disturbance.noise else []
    words += [f"drop{assignment.disturbance.dropped:g}"] if assignment.disturbance.dropped else []
    words += [assignment.observer] if assignment.observer != usual.observer else []
    return "-".join(words)


def summary_of(scores: dict[str, Any]) -> str:
    """Successes, timing and passivity of a flight, in lines for a terminal."""
    step = scores["step"]
    largest = ", ".join(f"{value:.3g}" for value in scores["largest_input"])
    lines = [
        f"{scores['law']}: {scores['successes']} of {scores['n']} starts keep the goal during the last second",
        f"  largest |u| {largest}; mean learned mass {scores['mean_mass']:.3g}",
        f"  frame in, input out: median {step['median_ms']:.2f} ms, 99th percentile {step['p99_ms']:.2f} ms of "
        f"{step['period_ms']:.0f} ms, {step['missed']} of {step['frames']} missed",
    ]
    if "passivity" in scores:
        passivity = scores["passivity"]
        lines.append(
            f"  T + V_d falls in {100 * passivity['falling_frames']:.0f} % of the frames, largest rise "
            f"{100 * passivity['largest_rise_median']:.1f} % of the flight's largest (median of starts)"
        )
    return "\n".join(lines)
