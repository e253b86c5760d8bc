"""The verb `keycld control`."""

import ast
import math
from importlib.metadata import entry_points
from pathlib import Path
from shlex import quote
from typing import Annotated, Any

import tyro

from keycld._errors import KeycldError

LAWS = Path(__file__).parent.parent / "control" / "laws"


def law_titles() -> str:
    """Return name, title and settings of the control laws, from their source files, because imports would load JAX.

    Of laws that installed packages add, only the entry points are read.
    """
    lines = []
    for path in sorted(LAWS.glob("*.py")):
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.ClassDef) and "register_law" in map(ast.unparse, node.decorator_list):
                lines.append(_law_title(node))
    lines += [f"{point.name}: In the installed module {point.module}." for point in entry_points(group="keycld.laws")]
    return "\n".join(lines)


def _law_title(law: ast.ClassDef) -> str:
    title = (ast.get_docstring(law) or "").partition("\n")[0]
    name, settings = "", []
    for field in law.body:
        if isinstance(field, ast.AnnAssign) and field.value is not None:
            target = ast.unparse(field.target)
            if target == "name":
                name = ast.literal_eval(field.value)
            elif "ClassVar" not in ast.unparse(field.annotation):
                settings.append(f"{target}={ast.unparse(field.value)}")
    return f"{name}: {title}" + (f" Settings: {', '.join(settings)}." if settings else "")


def control(
    run: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="RUN")],
    /,
    *,
    goal: str = "upright",
    law: Annotated[str, tyro.conf.arg(help=f"The control law.\n{law_titles()}\n", metavar="NAME")] = "shaping",
    set: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME=VALUE ...")] = (),
    limit: float | None = None,
    actuators: tuple[str, ...] = (),
    seconds: float = 10.0,
    trials: int = 1,
    seed: int = 0,
    estimator: Annotated[str, tyro.conf.arg(metavar="NAME")] = "predict-correct",
    noise: float = 0.0,
    drop: float = 0.0,
    out: Path | None = None,
    workers: int | None = None,
    json: bool = False,
) -> None:
    """Bring the simulated system to a goal pose from its pixels, with the physics that a model has learned.

    Each picture of the simulated system gives keypoints, the state estimator turns them into positions and velocities,
    the control law computes the input, and MuJoCo applies it until the next picture. Only the scores use the true
    state. Results: scores, trajectories, energies and timing in evaluation/, a movie and figures in media/.

    Examples: `keycld control cartpole --trials 20`, `keycld control acrobot --set kp=8 kd=3`,
    `keycld control pendulum --law mpc --limit 1 --seconds 20`.

    Args:
        run: Run folder, or a trained model of the package: pendulum, cartpole, acrobot.
        goal: upright, or a picture (.png) of the pose to reach, as large as the training pictures.
        law: The control law.
        set: Settings of the law, such as kp=8.
        limit: The largest |u|; no limit by default. mpc and random need one; the usual training data have 3.
        actuators: Names of the inputs that act; by default all inputs in the model's training data.
        seconds: Duration of each trial.
        trials: Number of random initial states, all at rest; the first trial is timed and shown.
        seed: Seed of initial states, noise and random inputs.
        estimator: The state estimator: predict-correct uses the learned dynamics, differences the last two frames.
        noise: Standard deviation of noise on the pictures, as a share of the full range.
        drop: Probability that a frame does not arrive.
        out: Folder for the results; by default the run's own.
        workers: Processes that simulate and render, at most four; by default one a core.
        json: Print the scores as JSON instead of a summary.
    """
    from keycld.cli.settings import parse_setting
    from keycld.cli.unfinished import say_if_unfinished
    from keycld.control import ControlConfig, Disturbance, law_named, swing_up
    from keycld.evaluation import save_evaluation
    from keycld.reports import write_control_media
    from keycld.systems import get, names
    from keycld.training import Counted, load_run, run_folder

    settings = ControlConfig(
        law=law_named(law, dict(parse_setting(text) for text in set)),
        limit=limit,
        actuators=actuators or None,
        seconds=seconds,
        trials=trials,
        seed=seed,
        estimator=estimator,
        disturbance=Disturbance(noise, drop),
    )
    picture = None if goal == "upright" else _picture(Path(goal))
    folder = run_folder(run)
    model, config = load_run(folder)
    say_if_unfinished(folder, "controlling with")
    if math.isnan(config.epsilon):
        raise KeycldError(f"{folder} is of an earlier version, which did not record ε of its data: train it again.")
    if config.system not in names():
        raise KeycldError(
            f"{folder} has learned the system '{config.system}', which keycld does not simulate: to control your own, "
            "use keycld.control.Agent (docs/control.md)."
        )
    result = swing_up(
        model,
        get(config.system),
        config.epsilon,
        picture,
        settings,
        input_names=config.input_names,
        progress=Counted("control"),
        workers=workers,
    )
    target, name = out or folder, _name(goal, settings)
    path = save_evaluation(target, name, result)
    movie, _, figure = write_control_media(target, name, result)
    if json:
        print(path.read_text(), end="")
        return
    print(summary_of(result.scores))
    print(f"stored: {path}, {movie}, {figure}")
    if out is None:
        print(f"next: keycld report {quote(str(run))}")


def _picture(path: Path) -> Any:
    from keycld.drawing import load_image

    try:
        return load_image(path)
    except FileNotFoundError:
        raise KeycldError(f"--goal takes upright or a picture; there is no file '{path}'.") from None


def _name(goal: str, config: Any) -> str:
    """Return the name of the result's files: goal, law, and all settings that are not the defaults.

    Trials and seed are no part of the name.
    """
    shown = Path(goal).stem
    if shown == "upright" and goal != "upright":
        # A picture of that name is another goal.
        shown = "picture-upright"
    words = ["control", shown, config.law.name]
    words += list(config.actuators or ())
    now, usual = config.as_dict(), type(config)(law=type(config.law)()).as_dict()
    chosen = {**now["law_settings"], "limit": now["limit"], "seconds": now["seconds"]}
    defaults = {**usual["law_settings"], "limit": usual["limit"], "seconds": usual["seconds"]}
    # A setting of an installed package's law may be a word.
    texts = {name: f"{value:g}" if isinstance(value, (int, float)) else str(value) for name, value in chosen.items()}
    words += [f"{name}{text}" for name, text in texts.items() if chosen[name] != defaults[name]]
    words += [f"noise{config.disturbance.noise:g}"] if config.disturbance.noise else []
    words += [f"drop{config.disturbance.dropped:g}"] if config.disturbance.dropped else []
    words += [config.estimator] if config.estimator != usual["estimator"] else []
    return "-".join(words)


def summary_of(scores: dict[str, Any]) -> str:
    """Return successes, timing and passivity of a closed-loop run as lines for a terminal."""
    step = scores["step"]
    largest = ", ".join(f"{value:.3g}" for value in scores["largest_input"])
    lines = [
        f"{scores['law']}: {scores['successes']} of {scores['n']} trials keep the goal during the last second",
        f"  largest |u| {largest}; mean learned mass {scores['mean_mass']:.3g}",
        f"  frame in, input out: median {step['median_ms']:.2f} ms, 99th percentile {step['p99_ms']:.2f} ms of "
        f"{step['period_ms']:.0f} ms, {step['missed']} of {step['frames']} missed",
    ]
    if "passivity" in scores:
        passivity = scores["passivity"]
        lines.append(
            f"  T + V_d falls in {100 * passivity['falling_frames']:.0f} % of the frames; its largest rise is "
            f"{100 * passivity['largest_rise_median']:.1f} % of its largest value (median of trials)"
        )
    return "\n".join(lines)
