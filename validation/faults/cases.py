"""What the campaign damages, and the verbs that read it."""

from typing import NamedTuple

from validation.faults.originals import WATCH


class Target(NamedTuple):
    """A file to damage, and the arguments of the verbs that read it; `{work}` stands for the folder of the case.

    The verbs take turns. `share` is the number of its cases in a round, larger where they are cheap. `without` names
    files that a case lacks: they would only cost time.
    """

    file: str
    share: int
    verbs: tuple[tuple[str, ...], ...]
    without: tuple[str, ...] = ()


_EVAL = ("eval", "{work}/run", "--data", "{work}/data", "--protocols", "test@10")
# The settings of the run, which the command line takes as text.
_TRAIN = ("train", "{work}/data", "--config", "{work}/run/config.json", "--out", "{work}/run")
_RESUME = ("train", "{work}/data", "--config", "{work}/half/config.json", "--out", "{work}/half")
_REPORT = ("report", "{work}/run")
_PREDICT = ("predict", "{work}/run", "--data", "{work}/data/test.h5", "--out", "{work}/out.h5")
_RENDER = ("predict", "{work}/run", "--data", "{work}/states/test.h5", "--out", "{work}/out.h5")
_CONTROL = ("control", "{work}/packaged", "--goal", "{work}/upright.png", "--seconds", "0.1", "--workers", "1")
_MJCF = ("export", "{work}/run", "--to", "mjcf", "--out", "{work}/out.xml")
_TEST = ("--data", "{work}/data", "--split", "test")
_TRACKS = tuple(("export", "{work}/run", "--to", to, *_TEST, "--out", "{work}/out") for to in ("csv", "lerobot"))
_LOG = ("identify", "{work}/log.csv", "--out", "{work}/identified", "--mechanism")
_WATCH = ("watch", "{work}/clip.mp4", "--mechanism", "pendulum", "--size", "16", "--set", *WATCH, "--out")
_WATCHED = ("report", "{work}/watched")
_CLIP = ("predict", "{work}/watched", "--data", "{work}/clip.mp4", "--given", "10", "--out", "{work}/out.h5")
_CHECK = ("data", "check", "{work}/data")
_SHOW = ("data", "show", "{work}/data", "--out", "{work}/out.gif", "--scale", "1")
_STATES = (("data", "check", "{work}/states"), ("data", "show", "{work}/states", "--out", "{work}/out.gif"))
_MAKE = ("data", "make", "toy/pendulum", "--train", "6", "--test", "2", "--long", "2", "--out", "{work}/states")
_TOML = ("--constraints", "{work}/data/constraints.toml")
_SUITE = ("data", "import", "{work}/matching_pennies", "--out", "{work}/imported")
_BENCH = ("--root", "{work}/bench", "--results", "{work}/results", "--systems", "pendulum", "--models", "keycld",
          "--seeds", "0,1")  # fmt: skip
_STATUS = ("bench", "status", "keycld", *_BENCH)
_TABLE = ("bench", "table", "keycld", *_BENCH, "--out", "{work}/out")
_FIGURES = ("bench", "figures", "keycld", *_BENCH, "--out", "{work}/out")
_PAGE = ("bench", "report", "keycld", *_BENCH, "--out", "{work}/out")
_PRIORS = ("priors", "--root", "{work}/bench", "--results", "{work}/results", "--systems", "toy/pendulum", "--models",
           "ar", "--seeds", "0")  # fmt: skip
_BOARD = tuple(("bench", verb, *_PRIORS, "--out", "{work}/out") for verb in ("table", "figures", "report"))


def _video(name: str) -> tuple[str, ...]:
    return ("data", "import", "{work}/" + name, "--out", "{work}/imported", "--size", "8", "--frames", "5")


_METRICS = "run/metrics.jsonl"
_SCORES = ("run/evaluation/test@10.json", "run/evaluation/test@10.npz")
_SWEEPS = ("run/evaluation/sweeps.json", "run/evaluation/sweeps.npz")
_CONTROLS = ("run/evaluation/control-goal-shaping.json", "run/evaluation/control-goal-shaping.npz")
_RESULTS = (*_SCORES, *_SWEEPS, *_CONTROLS)

TARGETS = (
    Target("data/train.h5", 8, (_CHECK, _SHOW)),
    Target("data/train.h5", 3, (_EVAL, _TRAIN)),
    Target("data/validation.h5", 6, (_CHECK,)),
    Target("data/validation.h5", 3, (_EVAL, _TRAIN)),
    Target("data/test.h5", 8, (_CHECK, _PREDICT)),
    Target("data/test.h5", 2, (_EVAL,)),
    Target("data/sweeps.h5", 5, (_CHECK,)),
    Target("data/sweeps.h5", 1, (_EVAL,)),
    Target("states/train.h5", 6, _STATES),
    Target("states/test.h5", 6, (_STATES[0], _RENDER)),
    Target("data/statistics.json", 6, (_CHECK, _SHOW)),
    Target("states/statistics.json", 6, (*_STATES, _MAKE)),
    Target("data/constraints.toml", 8, ((*_TRAIN, *_TOML), (*_video("swing.mp4"), *_TOML))),
    Target("run/config.json", 15, (_REPORT, _PREDICT, _TRAIN, _EVAL, _MJCF), (_METRICS, *_RESULTS)),
    Target("run/metrics.jsonl", 1, (_REPORT, _TRAIN), _RESULTS),
    Target("run/environment.json", 5, (_REPORT,), (_METRICS, *_RESULTS)),
    Target("run/verdict.json", 2, (_MJCF, _PREDICT, _EVAL)),
    Target("run/checkpoints/latest", 6, (_PREDICT, _EVAL, _MJCF)),
    Target("run/checkpoints/latest", 1, (_TRAIN,)),
    Target("run/checkpoints/C/position.json", 6, (_PREDICT, _EVAL, _MJCF)),
    Target("run/checkpoints/C/position.json", 2, (_TRAIN,)),
    Target("run/checkpoints/C/weights.safetensors", 6, (_PREDICT, _EVAL, _MJCF)),
    Target("run/checkpoints/C/weights.safetensors", 2, (_TRAIN,)),
    Target("half/checkpoints/C/state.safetensors", 1, (_RESUME,)),
    Target("half/config.json", 6, (_RESUME,)),
    Target("run/evaluation/test@10.json", 2, (_REPORT,), (_METRICS, *_SWEEPS, *_CONTROLS)),
    Target("run/evaluation/test@10.npz", 2, (_REPORT,), (_METRICS, *_SWEEPS, *_CONTROLS)),
    Target("run/evaluation/sweeps.json", 3, (_REPORT,), (_METRICS, *_SCORES, *_CONTROLS)),
    Target("run/evaluation/sweeps.npz", 5, (_REPORT,), (_METRICS, *_SCORES, *_CONTROLS)),
    Target("run/evaluation/control-goal-shaping.json", 3, (_REPORT,), (_METRICS, *_SCORES, *_SWEEPS)),
    Target("run/evaluation/control-goal-shaping.npz", 3, (_REPORT,), (_METRICS, *_SCORES, *_SWEEPS)),
    Target("swing.mp4", 6, (_video("swing.mp4"),)),
    Target("swing.gif", 6, (_video("swing.gif"),)),
    Target("matching_pennies/features.txt", 8, (_SUITE,)),
    Target("matching_pennies/train.tfrecord", 8, (_SUITE,)),
    Target("results/keycld/fast/pendulum-keycld-0.json", 12, (_STATUS, _TABLE, _FIGURES, _PAGE)),
    Target("results/keycld/fast/pendulum-keycld-1.failed.json", 6, (_STATUS, _TABLE)),
    Target("results/priors/fast/toy/pendulum-ar-0.json", 6, _BOARD),
    Target("upright.png", 4, (_CONTROL,)),
    Target("packaged/config.json", 4, (_CONTROL,)),
    Target("packaged/checkpoints/latest", 2, (_CONTROL,)),
    Target("packaged/checkpoints/C/position.json", 2, (_CONTROL,)),
    Target("packaged/checkpoints/C/weights.safetensors", 4, (_CONTROL,)),
    Target("log.csv", 4, ((*_LOG, "pendulum"),)),
    Target("data/constraints.toml", 3, ((*_LOG, "{work}/data/constraints.toml"),)),
    Target("run/evaluation/physics.json", 6, (_REPORT, _MJCF), (_METRICS, *_RESULTS)),
    Target("run/checkpoints/C/weights.safetensors", 3, (*_TRACKS, _MJCF)),
    Target("data/test.h5", 2, _TRACKS),
    Target("clip.mp4", 2, ((*_WATCH, "{work}/new"), _CLIP)),
    Target("watched/watch.json", 2, ((*_WATCH, "{work}/watched"),)),
    Target("watched/data/train.h5", 1, ((*_WATCH, "{work}/watched"),)),
    Target("watched/data/statistics.json", 2, ((*_WATCH, "{work}/watched"), _CLIP)),
    Target("watched/evaluation/motion.json", 4, (_WATCHED,)),
    Target("watched/evaluation/motion.npz", 4, (_WATCHED,)),
    Target("watched/evaluation/physics.json", 3, (_WATCHED,)),
)  # fmt: skip
ROUND = [(target, turn) for target in TARGETS for turn in range(target.share)]


def chosen(number: int, seed: int) -> tuple[Target, tuple[str, ...]]:
    """Return file and verb of a case."""
    target, turn = ROUND[number % len(ROUND)]
    return target, target.verbs[(number // len(ROUND) * target.share + turn + seed) % len(target.verbs)]
