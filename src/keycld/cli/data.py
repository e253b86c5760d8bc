"""The verbs `keycld data make | check | show | import`."""

from pathlib import Path
from shlex import quote
from typing import Annotated, Literal

import tyro

from keycld._errors import KeycldError


def make(
    system: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="SYSTEM")],
    /,
    *,
    out: Path | None = None,
    protocol: str | None = None,
    control: str | None = None,
    initial_state: Annotated[str | None, tyro.conf.arg(metavar="NAME")] = None,
    clip: bool | None = None,
    input: Literal["constant", "random-walk"] | None = None,
    size: Literal["default", "full"] = "default",
    store: Literal["states", "images"] | None = None,
    train: int | None = None,
    validation: int | None = None,
    test: int | None = None,
    long: int | None = None,
    all: bool = False,
    workers: int | None = None,
) -> None:
    """Make the data set of a system: pictures or states to render, true states, card, statistics, preview.

    Args:
        system: pendulum, cartpole or acrobot, or one of the zoo such as zoo/four_bar (docs/systems.md has all twelve),
            rendered by MuJoCo; or a set of "Which priors matter?" such as toy/pendulum_colors, games/matching_pennies,
            md/lj_16 or room/circle (docs/datasets.md has all 17). Interrupted work is resumed; finished data stay as
            they are.
        out: Folder; data/SYSTEM by default.
        protocol: keycld-2022 (arXiv v1) or keycld-2024 (journal version); zoo for the zoo; for toy sets
            priors-released (the configurations behind the published scores) or priors-paper (the text, where it
            differs). Default: keycld-2022, zoo, priors-released.
        control: Which inputs act: none, under (all but the second), full, or the name of the only one that acts,
            such as elbow_torque; by default as in the protocol.
        initial_state: rest, random, upright (half of them near that pose, for control that must hold it), released
            (at rest in any pose), or moving (in any pose and in motion, zoo only); by default as in the protocol.
        clip: Whether the motors limit the input to their range; by default as in the protocol.
        input: constant in each recording, or a random-walk with one value for each frame; by default constant.
        size: full is the published size of the md and room sets, which takes hours; the others have it by default.
        store: states (rendered when they are read) or images; by default states where possible.
        train: Recordings for training, for a smaller set; for toy, games, md and room with those for validation.
        validation: Recordings for validation.
        test: Recordings for the test.
        long: Recordings of the long test; by default no more than of the test.
        all: Make all files now; by default test_long.h5 of a mechanism in MuJoCo is made when it is first needed,
            for example by keycld eval.
        workers: Renderer processes, at most four; by default one a core.
    """
    from keycld.data import ProgressBar, make_data

    wanted = {"train": train, "validation": validation, "test": test, "test_long": long}
    made = make_data(
        system,
        out,
        protocol=protocol,
        control=control,
        initial_state=initial_state,
        clip=clip,
        input=input,
        size=size,
        store=store,
        runs={name: number for name, number in wanted.items() if number is not None},
        all=all,
        workers=workers,
        progress=ProgressBar(),
    )
    if not made.fresh:
        print(f"{made.folder} is already there: nothing to do")
        return
    print(f"made {made.folder} in {made.seconds:.0f} s, rendered by {made.renderer}")
    if made.later:
        print(f"later, when first needed: {', '.join(f'{name}.h5' for name in made.later)}")


def check(data: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="DATA")], /) -> None:
    """Check data files, and say what is wrong, where, and how to fix it.

    Args:
        data: An HDF5 file, or a folder with train.h5, validation.h5, …
    """
    from keycld.data import check as problems_of

    problems = problems_of(data)
    for problem in problems:
        print(problem)
    if problems:
        raise KeycldError(f"{len(problems)} problem{'s' if len(problems) > 1 else ''} in {data}, listed above.")
    print(f"{data}: no problems")


def show(
    data: Annotated[tyro.conf.Positional[str], tyro.conf.arg(metavar="DATA")],
    /,
    *,
    split: str = "train",
    recording: int = 0,
    out: Path | None = None,
    scale: int = 4,
) -> None:
    """Make a movie of one recording.

    Args:
        data: A system whose data is under data/, or a data set's folder.
        split: The file: train, validation, test or test_long.
        recording: The number of the recording; negative numbers count from the last.
        out: Movie, .gif or .mp4; DATA-SPLIT-RECORDING.gif by default.
        scale: Enlargement.
    """
    from keycld.cli.making import name_of
    from keycld.data import open_data
    from keycld.data import show as make_movie

    dataset = open_data(data)
    path = out or Path(f"{name_of(dataset.folder)}-{split}-{recording}.gif")
    count = dataset.count(split)
    if not -count <= recording < count:
        raise KeycldError(f"there is no recording {recording}: choose 0 to {count - 1}.")
    row = recording % count
    print(f"movie: {make_movie(dataset.split(split, rows=slice(row, row + 1)), path, scale=scale)}")


def import_(
    videos: Annotated[tyro.conf.Positional[tuple[Path, ...]], tyro.conf.arg(metavar="VIDEO ...")],
    /,
    *,
    out: Path,
    constraints: Annotated[str | None, tyro.conf.arg(aliases=["--mechanism"])] = None,
    size: int = 64,
    fps: float | None = None,
    crop: Annotated[tuple[int, int, int, int] | None, tyro.conf.arg(metavar="LEFT TOP WIDTH HEIGHT")] = None,
    skip: Annotated[float | None, tyro.conf.arg(name="from", metavar="SECONDS")] = None,
    until: Annotated[float | None, tyro.conf.arg(metavar="SECONDS")] = None,
    frames: int = 50,
    split: Literal["recordings", "time"] = "recordings",
) -> None:
    """Turn videos, or a downloaded set of "Which priors matter?", into a data set.

    Videos are cropped, resized, resampled in time and cut into recordings. `--split time` is for short clips of one
    motion, as `keycld watch` makes them: what moves is found, and training, validation and test are consecutive parts.

    Args:
        videos: One or more video files; or one folder of the original suite, with features.txt and train.tfrecord,
            and no option but --out.
        out: Folder of the data set.
        constraints: TOML file with keypoint names and constraints, or the name of a mechanism: pendulum,
            double-pendulum, cart-pole, spring; written into the folder.
        size: Height and width of the pictures, a multiple of 8.
        fps: Frames a second to keep; by default those of the video. With --split time all frames are kept, and this is
            the rate at which the camera recorded them.
        crop: Part of the picture to keep, in pixels of the video; by default the largest central square, with --split
            time what moves.
        skip: Second of each video at which to begin, as a player shows it; by default the first, with --split time that
            of the longest stretch in which nothing moves but the mechanism.
        until: Second at which to stop; by default the end, or that of this stretch.
        frames: Frames of a recording; not used with --split time.
        split: recordings gives the first recordings of --frames frames each to training and the last ones to the test;
            time splits each video in time, 60 % for training and the last third for the test.
    """
    from keycld.data import changes_of, import_clip, import_suite, import_video, open_data

    if len(videos) == 1 and (videos[0] / "features.txt").exists():
        usual = {"size": size == 64, "frames": frames == 50, "split": split == "recordings"}
        free = {"constraints": constraints, "fps": fps, "crop": crop, "from": skip, "until": until}
        usual |= {name: value is None for name, value in free.items()}
        if given := [f"--{name}" for name, unchanged in usual.items() if not unchanged]:
            raise KeycldError(f"{videos[0]} is imported as it was published: leave out {', '.join(given)}.")
        print(f"imported: {import_suite(videos[0], out)}")
        return
    if split == "time":
        if constraints is None:
            raise KeycldError("--split time needs the mechanism: add --mechanism pendulum, or a TOML file.")
        clip = import_clip(
            list(videos), out, size=size, fps=fps, crop=crop, skip=skip, until=until, constraints=constraints
        )
        print(f"imported: {clip.folder}, {clip.fps:g} frames/s, crop {' '.join(map(str, clip.crop))}")
        for line in changes_of(open_data(clip.folder).attributes):
            print(line)
        print(f"next: keycld train {quote(str(clip.folder))} --preset clip")
        return
    folder = import_video(
        list(videos),
        out,
        size=size,
        fps=fps,
        crop=crop,
        skip=skip or 0.0,
        until=until,
        frames=frames,
        constraints=constraints,
    )
    print(f"imported: {folder}\nnext: keycld data show {quote(str(folder))}, keycld train {quote(str(folder))}")
