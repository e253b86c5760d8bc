"""The sets of "Which priors matter?": CPU time of a trajectory, scores of the mean picture, pictures for the gallery.

python validation/suite.py measure [SET ...]     results/datasets/suite.json
python validation/suite.py gallery [SET ...]     docs/media/suite-*.png
"""

import argparse
import json
import time
from pathlib import Path
from typing import Any

from keycld.data.describe.normalised_error import trivial_scores
from keycld.drawing import enlarge, save_image, sheet
from keycld.systems import (
    AbstractInitialValueSystem,
    AbstractSampledSystem,
    Recording,
    Task,
    get,
    names,
    run_in_processes,
)

# Scores of the mean image in the units of tables 5 and 6, measured with the suite's own generator, and the seconds that
# it took for a trajectory of 256 frames (the lowest found).
ANCHORS = {
    "toy/mass_spring": (170, 1.35),
    "toy/mass_spring_colors": (160.4, 1.35),
    "toy/mass_spring_colors_friction": (159.6, 1.35),
    "toy/pendulum": (266, 1.35),
    "toy/pendulum_colors": (222, 1.35),
    "toy/pendulum_colors_friction": (228, 1.35),
    "toy/double_pendulum": (210, 3.2),
    "toy/double_pendulum_colors": (100.7, 3.2),
    "toy/double_pendulum_colors_friction": (100.6, 3.2),
    "toy/two_body": (316, 3.2),
    "toy/two_body_colors": (101.5, 3.2),
    "games/matching_pennies": (1235, 0.3),
    "games/rock_paper_scissors": (1672, 0.3),
}
COUNT, FRAMES, EVERY = 2000, 256, 8
TEST = 2_100_000


def sampled(name):
    """Return the set of that name."""
    system = get(name)
    assert isinstance(system, AbstractSampledSystem), f"{name} is not a set of the suite"
    return system


def record(name, numbers):
    return sampled(name).record(numbers, FRAMES, sampled(name).protocols[0], "default")


def measure(name):
    """Return CPU milliseconds of a trajectory, without compilation, and the scores of the mean picture."""
    system = sampled(name)
    record(name, range(5_000_000, 5_000_000 + COUNT))
    before = time.process_time()
    train = record(name, range(COUNT))
    states = time.process_time() - before
    few = Recording(train.time, train.state[:100], {key: value[:100] for key, value in train.parameters.items()})
    system.pictures(few)
    before = time.process_time()
    system.pictures(few)
    pictures = time.process_time() - before
    test = record(name, range(TEST, TEST + COUNT))
    shown = [
        system.pictures(Recording(each.time[::EVERY], each.state[:, ::EVERY], each.parameters)).image
        for each in (train, test)
    ]
    scores = trivial_scores(*([image] for image in shown))["mean_image"]
    anchor, original = ANCHORS[name]
    mine = states / COUNT + pictures / 100
    return {
        "states_ms": round(1e3 * states / COUNT, 3),
        "pictures_ms": round(10 * pictures, 3),
        "original_s": original,
        "times_faster": round(original / mine),
        "mean_image": {key: round(value, 4) for key, value in scores.items()},
        "anchor": anchor,
        "ratio": round(scores["table_units"] / anchor, 4),
    }


def picture(name):
    """Save a picture of two trajectories, twelve frames each."""
    recording = record(name, range(2))
    every = {"room": 22, "md": 16}.get(name.split("/")[0], 6)
    short = Recording(recording.time, recording.state[:, : 12 * every], recording.parameters)
    if name.startswith("room"):
        [(_, pictures)] = run_in_processes([Task(sampled(name).pictures, (short,))])
    else:
        pictures = sampled(name).pictures(short)
    save_image(
        Path("docs/media") / f"suite-{name.replace('/', '-')}.png",
        sheet([enlarge(image, 2) for image in pictures.image], every=every, gap=2),
    )


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=["measure", "gallery"])
    parser.add_argument("sets", nargs="*")
    options = parser.parse_args()
    if options.what == "gallery":
        for name in options.sets or names(AbstractSampledSystem):
            picture(name)
        return
    path = Path("results/datasets/suite.json")
    result: dict[str, Any] = {"command": "python validation/suite.py measure"}
    if path.exists():
        result = json.loads(path.read_text())
    for name in options.sets or names(AbstractInitialValueSystem):
        result[name] = measure(name)
        print(name, json.dumps(result[name]), flush=True)
        path.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
