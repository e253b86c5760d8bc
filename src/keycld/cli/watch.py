"""The verb `keycld watch`: clips of one mechanism in, its physics out."""

import contextlib
import re
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from json import dumps
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from keycld._errors import KeycldError, check_seed
from keycld._files import write_text
from keycld._records import read_json
from keycld.cli.alternatives import (
    AUTO,
    COMPARISON,
    NOT_IDENTIFIABLE,
    WITHOUT_A_MODEL,
    alternatives_table,
    compare,
    measure_parts,
    name_of,
)

if TYPE_CHECKING:
    from keycld.data import DataSet
    from keycld.evaluation import Evaluation, Physics
    from keycld.evaluation.physics_file import Alternative
    from keycld.mechanics import Scale
    from keycld.models.base import AbstractModel

_REQUEST = "watch.json"
"""In a run folder: which clips and options its data were made of."""
_DEFAULTS = {"plane_ratio": 1.0}
"""Options that runs of earlier versions do not name."""
_LENGTH = re.compile(r"\s*(.+?)\s*=\s*(\d+\.?\d*|\.\d+)\s*(m|cm|mm)\s*")
_UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001}


def watch(
    clips: Annotated[tyro.conf.Positional[tuple[Path, ...]], tyro.conf.arg(metavar="CLIP ...")],
    /,
    *,
    mechanism: Annotated[str | None, tyro.conf.arg(aliases=["--constraints"])] = None,
    fps: float | None = None,
    crop: Annotated[tuple[int, int, int, int] | None, tyro.conf.arg(metavar="LEFT TOP WIDTH HEIGHT")] = None,
    plane: Annotated[
        tuple[float, float, float, float, float, float, float, float] | None,
        tyro.conf.arg(metavar="X1 Y1 X2 Y2 X3 Y3 X4 Y4"),
    ] = None,
    plane_ratio: float = 1.0,
    skip: Annotated[float | None, tyro.conf.arg(name="from", metavar="SECONDS")] = None,
    until: Annotated[float | None, tyro.conf.arg(metavar="SECONDS")] = None,
    size: int | None = None,
    length: str | None = None,
    gravity: float | None = None,
    out: Path | None = None,
    set: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME=VALUE ...")] = (),
    seed: int = 0,
    json: bool = False,
    live: Path | None = None,
    ahead: float = 1.0,
    given: int = 10,
    port: int = 8000,
) -> None:
    """Learn the physics of a mechanism from one video, or from several of the same place, in minutes.

    The part that moves is found, the video is split in time, a model is trained on the first part, its constants are
    measured with error bars, and the last third is predicted from its first ten frames. The same command resumes.

    Args:
        clips: Videos of one mechanism by a camera at rest, of 60 frames or more; of more than 1,200 some are left out.
        mechanism: What moves: pendulum, double-pendulum, cart-pole or spring; or a TOML file with keypoints and
            constraints; or auto, which finds it where parts differ in colour. Needed unless --live is given.
        fps: Frames a second with which the camera recorded, where the file states another rate, such as slow motion.
        crop: Part of the picture to keep, a square in pixels of the video; by default what moves.
        plane: Where the camera looks at the plane of the motion from the side: pixels of the corners of a rectangle in
            that plane, top left, top right, bottom right, bottom left. Its view from the front is learned.
        plane_ratio: Width of that rectangle divided by its height.
        skip: Second of each video at which to begin, as a player shows it. By default the longest stretch is used in
            which nothing moves but the mechanism: no hand, no passer-by.
        until: Second at which to stop; by default the end of that stretch.
        size: Height and width of the pictures that the model sees, a multiple of 8; by default 64, or up to 128 where
            parts are small.
        length: A known length, such as "pivot-ball = 0.31 m", for constants in metres.
        gravity: The strength of gravity in m/s², such as 9.81; sets the scale where no length does, and is compared
            with the measured one otherwise.
        out: Run folder; by default runs/CLIP-watch-SEED.
        set: Settings of the preset clip to change, such as vision.steps=1500.
        seed: Seed of weights and data order.
        json: Print the contents of evaluation/physics.json, and everything else on the standard error.
        live: A run folder that keycld watch has made: CLIP is a camera in the same place, such as /dev/video0, or a
            video that is played as one, and a page shows its keypoints now and predicted.
        ahead: With --live, seconds to predict.
        given: With --live, frames to predict from.
        port: With --live, port of the page on this machine; 0 is a free one.
    """
    from keycld.cli.live import live as show_live
    from keycld.cli.settings import parse_setting
    from keycld.data import changes_of
    from keycld.evaluation import MOTION, as_json, evaluate_motion, load_physics, save_evaluation, save_physics
    from keycld.models import config_for
    from keycld.reports import write_report
    from keycld.training import Counted
    from keycld.training import train as train_model

    began = time.monotonic()
    check_seed(seed)
    if not clips:
        raise KeycldError("name at least one video: keycld watch swing.mp4 --mechanism pendulum.")
    if live is not None:
        source, *more = clips
        if more:
            raise KeycldError(f"--live shows one video or camera, not {1 + len(more)}.")
        return show_live(source, live, seconds=ahead, given=given, port=port)
    if mechanism is None:
        raise KeycldError("name what moves, such as --mechanism pendulum, or find it with --mechanism auto.")
    scale = None if mechanism == AUTO else scale_of(length, gravity, mechanism)
    settings = config_for("keycld", "clip", **dict(parse_setting(text) for text in set))
    run = out or Path("runs") / f"{clips[0].stem}-watch-{seed}"
    with contextlib.redirect_stdout(sys.stderr if json else sys.stdout):
        options = {"fps": fps, "crop": crop, "plane": plane, "plane_ratio": plane_ratio, "skip": skip, "until": until}
        with _claimed(run, clips, mechanism, size, options):
            chosen, compared = compare(clips[0], run, options) if mechanism == AUTO else (mechanism, [])
            if chosen is not None and mechanism == AUTO:
                print(alternatives_table(compared), flush=True)
                scale = scale_of(length, gravity, chosen)
            data = None if chosen is None else _imported(run, clips, chosen, size, options)
        if chosen is None or data is None:
            save_physics(run, _unidentified(compared))
            print(NOT_IDENTIFIABLE, flush=True)
        else:
            try:
                model = train_model(data.folder, run, settings, seed=seed)
            except KeycldError as failure:
                measured = _measured_without_model(run, clips[0], chosen, options, scale)
                if measured is None:
                    raise
                physics = measured
                print(f"caution      {failure}\ncaution      {WITHOUT_A_MODEL}", flush=True)
            else:
                motion = evaluate_motion(model, data, progress=Counted("predict"))
                save_evaluation(run, MOTION, motion)  # Kept if the constants cannot be measured.
                physics, motion = _measure(run, model, data, motion, chosen, scale)
                save_evaluation(run, MOTION, motion)
            physics["given"] = measured_by_hand(scale, gravity)
            physics["changes"] = changes_of(data.attributes)
            if compared:
                physics["alternatives"] = compared
            save_physics(run, physics)
            print(f"{time.monotonic() - began:.0f} s; open {write_report(run)} in a browser", flush=True)
    print(as_json(dict(load_physics(run))) if json else _table(load_physics(run)))


def scale_of(length: str | None, gravity: float | None, mechanism: str) -> "Scale | None":
    """Return what makes units metres: a length such as "pivot-ball = 0.31 m", without one the strength of gravity.

    Raises:
        KeycldError: the text is no length, the mechanism has no such length, or a value is not above zero.
    """
    import jax.numpy as jnp

    from keycld.mechanics import Scale, lengths_of, load_constraints

    if gravity is not None and not 0 < gravity < float("inf"):
        raise KeycldError(f"--gravity is a number of m/s² above 0, not {gravity}.")
    if length is None:
        return None if gravity is None else Scale(None, gravity)
    found = _LENGTH.fullmatch(length)
    metres = float(found[2]) * _UNITS[found[3]] if found else 0.0
    if found is None or not 0 < metres < float("inf"):
        raise KeycldError(f'--length is two ends and a length, such as "pivot-ball = 0.31 m", not "{length}".')
    constraints = load_constraints(mechanism)
    known = {"-".join(ends): ends for ends in lengths_of(constraints, jnp.ones(constraints.count))}
    between = re.sub(r"\s*[-–]\s*", "-", found[1])
    ends = next((ends for name, ends in known.items() if between in (name, "-".join(reversed(ends)))), None)
    if ends is None:
        raise KeycldError(
            f"no length {between} is constant in this mechanism: choose from {', '.join(known) or 'none'}."
        )
    return Scale(ends, metres)


def measured_by_hand(scale: "Scale | None", gravity: float | None) -> dict[str, float]:
    """Return what the user has measured, by the names of the constants in metres."""
    length = {} if scale is None or scale.between is None else {f"length_{'_'.join(scale.between)}_m": scale.value}
    return length | ({} if gravity is None else {"gravity_m": gravity})


def _unidentified(compared: "list[Alternative]") -> "Physics":
    """Return the answer where no mechanism was found."""
    return {
        "mechanism": None,
        "fps": None,
        "constants": {},
        "rejected": {},
        "prediction": {},
        "alternatives": compared,
        "note": NOT_IDENTIFIABLE,
    }


@contextlib.contextmanager
def _claimed(
    run: Path, clips: Sequence[Path], mechanism: str, size: int | None, options: Mapping[str, Any]
) -> Iterator[None]:
    """Say in the run folder what its data are made of; leave no new folder behind where that fails.

    Raises:
        KeycldError: the run is of other clips or options.
    """
    from keycld.data import sha256
    from keycld.data.imports.video import constraints_text

    for clip in clips:
        if not clip.is_file():
            raise KeycldError(f"there is no video {clip}: check the path.")
    request = {
        "clips": [sha256(clip) for clip in clips],
        "constraints": mechanism if mechanism == AUTO else constraints_text(mechanism),
        "size": size,
        **{name: list(value) if isinstance(value, tuple) else value for name, value in options.items()},
    }
    there = run.exists()
    if (run / "config.json").exists() and not (run / _REQUEST).exists():
        raise KeycldError(f"{run} is a run of keycld train: choose another --out.")
    if (run / _REQUEST).exists():
        before = read_json(run / _REQUEST, dict[str, Any], f"delete {run}")
        for name, value in request.items():
            # Without a size it is that of the data.
            if before.get(name, _DEFAULTS.get(name)) != value and not (name == "size" and value is None):
                what = "seconds" if name in ("skip", "until") else name
                raise KeycldError(f"{run} is of other {what}: choose another --out, or delete that folder.")
    try:
        write_text(run / _REQUEST, dumps(request, indent=1))
        yield
    except KeycldError:
        # Data that are there now are another process's, or unfinished ones that the same command continues.
        if not there and not (run / "data").exists():
            for name in (_REQUEST, *COMPARISON):
                (run / name).unlink(missing_ok=True)
            with contextlib.suppress(OSError):
                run.rmdir()
        raise


def _imported(
    run: Path, clips: Sequence[Path], mechanism: str, size: int | None, options: Mapping[str, Any]
) -> "DataSet":
    """Return the data set of a run, made of the clips unless it is there.

    Raises:
        KeycldError: as `import_clip`, which leaves nothing.
    """
    from keycld.data import changes_of, finished, import_clip, open_data

    folder = run / "data"
    if finished(folder):
        return open_data(folder)
    made = import_clip(clips, folder, constraints=mechanism, size=size, **options)
    counts = f"{made.frames[0]} for training, {made.frames[1]} for validation, {made.frames[2]} for the test"
    crop = f"{' '.join(map(str, made.crop))} to {made.size} x {made.size}"
    data = open_data(folder)
    for line in (f"{made.fps:g} frames/s, crop {crop}, frames: {counts}", *changes_of(data.attributes)):
        print(f"clip         {line}", flush=True)
    return data


def _measured_without_model(
    run: Path, clip: Path, mechanism: str, options: Mapping[str, Any], scale: "Scale | None"
) -> "Physics | None":
    """Measure the constants of a clip whose training has failed; None if it has not, or its parts do not allow it.

    What goes wrong here is not said: why the training has failed is what helps.
    """
    from keycld.models.keycld.recipes.clip import ClipConfig
    from keycld.training import read_config, read_verdict

    verdict = read_verdict(run)
    if verdict is None or verdict["passed"]:
        return None
    config = read_config(run).model_config()
    if isinstance(config, ClipConfig):
        with contextlib.suppress(KeycldError):
            return measure_parts(clip, run, options, mechanism, config.tried, scale)
    return None


def _measure(
    run: Path, model: "AbstractModel", data: "DataSet", motion: "Evaluation", mechanism: str, scale: "Scale | None"
) -> "tuple[Physics, Evaluation]":
    """Measure the constants on the training keypoints; return them with the scores of the prediction, and its fan."""
    from keycld.evaluation import fitted_tracks, measure_physics, pieces_note, restless, with_fan
    from keycld.mechanics import MechanicalDynamics
    from keycld.models.keycld.model import KeyCLD
    from keycld.models.keycld.recipes.clip import ClipConfig
    from keycld.training import read_config

    config = read_config(run).model_config()
    assert isinstance(model, KeyCLD) and isinstance(config, ClipConfig)
    dynamics = model.dynamics
    assert isinstance(dynamics, MechanicalDynamics)
    x, u = fitted_tracks(model, data)
    measured = measure_physics(
        dynamics,
        x,
        u,
        data.dt,
        mechanism=name_of(mechanism, run),
        scale=scale,
        tried=config.tried,
        pixel=motion.scores["pixel"],
    )
    motion = with_fan(motion, measured.estimate, data.split("test").input[0])
    said = ("given", "frames", "size", "error", "valid", "baselines", "skeleton", "noise", "within")
    prediction = {name: motion.scores[name] for name in said if name in motion.scores}
    if note := pieces_note(measured.physics):
        print(f"constants    {note}", flush=True)
    if caution := restless(prediction["noise"]):
        print(f"caution      {caution}", flush=True)
    return {**measured.physics, "prediction": prediction}, motion


def _table(physics: "Physics") -> str:
    """Return the constants, one a line; without any the mechanisms that were compared."""
    from keycld.evaluation import constants_table

    if not physics["constants"]:
        return alternatives_table(physics.get("alternatives", []))
    return constants_table(physics)
