"""What the campaign damages, and the verbs that read it."""

import json
import shutil
import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np


class Target(NamedTuple):
    """A file to damage, and the arguments of the verbs that read it; `{work}` stands for the folder of the case.

    `without` names files that a case lacks: they would only cost time.
    """

    file: str
    verbs: tuple[tuple[str, ...], ...]
    without: tuple[str, ...] = ()


_EVAL = ("eval", "{work}/run", "--data", "{work}/data", "--protocols", "test@10")
# The settings of the run, which the command line takes as text.
_TRAIN = ("train", "{work}/data", "--config", "{work}/run/config.json", "--out", "{work}/run")
_REPORT = ("report", "{work}/run")
_PREDICT = ("predict", "{work}/run", "--data", "{work}/data/test.h5", "--out", "{work}/out.h5")
_CHECK = ("data", "check", "{work}/data")
_SHOW = ("data", "show", "{work}/data", "--out", "{work}/out.gif", "--scale", "1")
_VIDEO = ("data", "import", "{work}/swing.mp4", "--out", "{work}/imported", "--size", "8", "--frames", "5")
_SUITE = ("data", "import", "{work}/matching_pennies", "--out", "{work}/imported")
_BENCH = ("--root", "{work}/bench", "--results", "{work}/results", "--systems", "pendulum", "--models", "keycld",
          "--seeds", "0")  # fmt: skip

_METRICS = "run/metrics.jsonl"
_SCORES = ("run/evaluation/test@10.json", "run/evaluation/test@10.npz")
_SWEEPS = ("run/evaluation/sweeps.json", "run/evaluation/sweeps.npz")

TARGETS = (
    Target("data/train.h5", (_CHECK, _SHOW, _EVAL, _TRAIN)),
    Target("data/validation.h5", (_CHECK, _EVAL, _TRAIN)),
    Target("data/test.h5", (_CHECK, _PREDICT, _EVAL)),
    Target("data/sweeps.h5", (_CHECK, _EVAL)),
    Target("data/statistics.json", (_CHECK, _SHOW)),
    Target("data/constraints.toml", ((*_TRAIN, "--constraints", "{work}/data/constraints.toml"),
                                     (*_VIDEO, "--constraints", "{work}/data/constraints.toml"))),
    Target("run/config.json", (_REPORT, _PREDICT, _TRAIN, _EVAL), (_METRICS, *_SCORES, *_SWEEPS)),
    Target("run/metrics.jsonl", (_REPORT, _TRAIN), (*_SCORES, *_SWEEPS)),
    Target("run/environment.json", (_REPORT,), (_METRICS, *_SCORES, *_SWEEPS)),
    Target("run/verdict.json", (_PREDICT, _EVAL)),
    Target("run/checkpoints/latest", (_PREDICT, _TRAIN, _EVAL)),
    Target("run/checkpoints/C/position.json", (_PREDICT, _TRAIN)),
    Target("run/checkpoints/C/weights.safetensors", (_PREDICT, _TRAIN)),
    Target("run/checkpoints/C/state.safetensors", (_TRAIN,)),
    Target("run/evaluation/test@10.json", (_REPORT,), (_METRICS, *_SWEEPS)),
    Target("run/evaluation/test@10.npz", (_REPORT,), (_METRICS, *_SWEEPS)),
    Target("run/evaluation/sweeps.json", (_REPORT,), (_METRICS, *_SCORES)),
    Target("run/evaluation/sweeps.npz", (_REPORT,), (_METRICS, *_SCORES)),
    Target("swing.mp4", (_VIDEO,)),
    Target("matching_pennies/features.txt", (_SUITE,)),
    Target("matching_pennies/train.tfrecord", (_SUITE,)),
    Target("results/keycld/fast/pendulum-keycld-0.json",
           (("bench", "status", "keycld", *_BENCH), ("bench", "table", "keycld", *_BENCH, "--out", "{work}/out"),
            ("bench", "figures", "keycld", *_BENCH, "--out", "{work}/out"))),
    Target("goal.png", (("control", "{work}/run", "--goal", "{work}/goal.png", "--seconds", "0.1"),)),
)  # fmt: skip


def make_originals(folder: Path, repository: Path) -> None:
    """Make one whole file of every kind: a small data set, a trained and evaluated run, a video, a suite, results."""
    sys.path.insert(0, str(repository / "tests"))
    from keycld.benchmarks import suite_named
    from keycld.data import Trajectories, open_data, read, write
    from keycld.data.describe.statistics import split_statistics
    from keycld.drawing import save_image, save_movie
    from keycld.evaluation import evaluate, protocol_named, save_evaluation
    from keycld.evaluation.evaluate import Evaluation
    from keycld.models import config_for
    from keycld.training import train
    from keycld.training.checkpoints import latest_checkpoint
    from scenes import TINY, write_data  # pyright: ignore[reportMissingImports]

    write_data(folder / "data")
    (folder / "data" / "constraints.toml").write_text(
        'keypoints = ["tip"]\n\n[[constraint]]\nkind = "distance_to_point"\nkeypoint = "tip"\npoint = [0.0, 0.0]\n'
    )
    model = train(folder / "data", folder / "run", config_for("keycld", "fast", **TINY), log_every=2)
    newest = latest_checkpoint(folder / "run")
    assert newest is not None
    newest.rename(newest.with_name("C"))
    (folder / "run/checkpoints/latest").write_text("C")
    _json(folder / "run/verdict.json", {"passed": True, "failures": []})
    data = open_data(folder / "data")
    save_evaluation(folder / "run", "test@10", evaluate(model, data, protocol_named("test@10")))
    image = read(folder / "data/train.h5", rows=slice(0, 1)).image
    assert image is not None
    pictures = image[0, :5]
    arrays = {
        "names": np.array(["turn"]), "vary": np.array(["angle"]), "units": np.array(["rad"]),
        "turn/values": np.linspace(0, 1, 5)[:, None], "turn/shape": np.array([5]),
        "turn/potential": np.arange(5, dtype=np.float32), "turn/keypoints": np.zeros((5, 1, 2), np.float32),
        "turn/image": pictures,
    }  # fmt: skip
    save_evaluation(folder / "run", "sweeps", Evaluation({"potential_range": {"turn": 4.0}}, arrays))
    sweeps = Trajectories(
        time=data.dt * np.arange(1, 6), input=np.zeros((1, 1), np.float32), image=pictures[None],
        state=np.zeros((1, 5, 2)),
        parameters={"name": np.array(["turn"]), "vary": np.array(["angle"]), "length": np.array([5]),
                    "shape": np.array([[5, 1]])},
        attributes={"system": data.system, "dt": data.dt, "state_names": ("angle", "rate"), "units": ("rad", "rad/s")},
    )  # fmt: skip
    write(folder / "data/sweeps.h5", sweeps)
    splits = {path.stem: split_statistics(path) for path in sorted((folder / "data").glob("*.h5"))}
    recipe = {"system": "mine", "protocol": "own", "splits": []}
    _json(folder / "data/statistics.json", {"splits": splits, "recipe": recipe, "seconds": 1.0, "renderer": "x"})
    movie = np.random.default_rng(0).integers(0, 255, (30, 16, 24, 3), np.uint8)
    save_movie(folder / "swing.mp4", movie, fps=25, scale=1)
    save_image(folder / "goal.png", pictures[0])
    shutil.copytree(repository / "tests/data/golden/tfrecord/matching_pennies", folder / "matching_pennies")
    name = "results/keycld/fast/pendulum-keycld-0.json"
    (folder / name).parent.mkdir(parents=True)
    # As if it were of today's settings.
    stored = json.loads((repository / name).read_text())
    experiment = suite_named("keycld").select(systems=("pendulum",), models=("keycld",), seeds=(0,))[0]
    _json(folder / name, stored | {"config_hash": experiment.hash()})
    (folder / "bench").mkdir()


def _json(path: Path, value: object) -> None:
    path.write_text(json.dumps(value))
