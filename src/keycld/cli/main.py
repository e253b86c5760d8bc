"""The command line: find the verb, parse its arguments, then import what the verb needs."""

import os
import sys
import traceback
import warnings
from collections.abc import Callable, Sequence

import tyro

from keycld._compile_cache import SWITCH, use_compile_cache
from keycld._errors import KeycldError, unknown
from keycld._version import __version__
from keycld.cli import (
    bench,
    control,
    data,
    demo,
    evaluate,
    export,
    identify,
    info,
    models,
    predict,
    report,
    train,
    watch,
)
from keycld.cli.start import after_an_end, entry, say, unforeseen


def data_sets() -> None:
    """Make, check, show or import data sets: see `keycld data --help`."""
    main(["data", "--help"])


def benchmarks() -> None:
    """Run the papers' experiments and make their tables and figures: see `keycld bench --help`."""
    main(["bench", "--help"])


VERBS: dict[str, Callable] = {
    "demo": demo.demo,
    "data": data_sets,
    "watch": watch.watch,
    "train": train.train,
    "eval": evaluate.evaluate,
    "predict": predict.predict,
    "control": control.control,
    "identify": identify.identify,
    "export": export.export,
    "report": report.report,
    "bench": benchmarks,
    "models": models.models,
    "info": info.info,
}
GROUPS: dict[str, tuple[dict[str, Callable], str]] = {
    "data": (
        {"make": data.make, "check": data.check, "show": data.show, "import": data.import_},
        "Make, check, show and import data sets.",
    ),
    "bench": (
        {
            "run": bench.run,
            "status": bench.status,
            "table": bench.table,
            "figures": bench.figures,
            "report": bench.report,
        },
        "Run the papers' experiments and make their tables and figures.",
    ),
}
DESCRIPTION = f"""keycld {__version__}: learn the physics of a moving system from video, then predict and control it.

`keycld watch clip.mp4 --mechanism pendulum` learns the physics of one video.
`keycld demo` shows everything on one system. Step by step: `keycld train cartpole` (makes the data first),
`keycld eval RUN`, `keycld control RUN`, `keycld report RUN`, where RUN is the folder that `train` prints.

Options:
  --debug              With any verb: show where an error came from.
  --no-compile-cache   With any verb: keep no compiled programs (`keycld info` shows where); also by {SWITCH}=off.
  -V, --version        Print the version."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one verb and return the exit code: 0, 2 after one sentence about an error, 130 when interrupted."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    then = after_an_end(words)
    # By default JAX reserves three quarters of a GPU's memory at its first use; a renderer needs some of it.
    os.environ.setdefault("XLA_PYTHON_CLIENT_PREALLOCATE", "false")
    # And writes ten lines of Python into a program for each of its operations, a tenth of the time to make it.
    os.environ.setdefault("JAX_TRACEBACK_IN_LOCATIONS_LIMIT", "0")
    debug = "--debug" in words
    if debug:
        words.remove("--debug")
    if "--no-compile-cache" in words:
        words.remove("--no-compile-cache")
        os.environ[SWITCH] = "off"
    use_compile_cache()
    # JAX warns at every child process; ours are ffmpeg and fresh interpreters, which start with exec.
    warnings.filterwarnings("ignore", "os.fork", RuntimeWarning)
    try:
        verbs, prog, description = VERBS, "keycld", DESCRIPTION
        if words and words[0] in GROUPS:
            verbs, description = GROUPS[words[0]]
            prog, words = f"keycld {words[0]}", words[1:]
        elif words[:1] in (["--version"], ["-V"]):
            print(__version__)
            return 0
        if words and not words[0].startswith("-") and words[0] not in verbs:
            raise unknown("verb", words[0], verbs, listed="`keycld --help`")
        if words[:1] == ["train"]:
            verbs = {**verbs, "train": train.with_settings(words)}
        if words and words[0] in verbs:
            # The others would only slow down the start, and their options would be suggested for this one.
            verbs = {words[0]: verbs[words[0]]}
        tyro.extras.subcommand_cli_from_dict(verbs, prog=prog, description=description, args=words or ["--help"])
    except KeycldError as error:
        if debug:
            traceback.print_exc()
        say(f"keycld: {error}")
        return 2
    except BrokenPipeError:
        # The reader, such as `head`, has closed the pipe. Without this, Python's own flush at the end fails too.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except KeyboardInterrupt:
        say(f"keycld: interrupted; {then}.")
        return 130
    except MemoryError:
        say("keycld: there is not enough memory: close other programs, or use smaller data or fewer recordings.")
        return 2
    except Exception as error:
        if isinstance(error, OSError) and error.filename is not None:
            say(f"keycld: {error.filename}: {error.strerror}: check the path and its permissions.")
        else:
            say(f"keycld: {unforeseen(error, debug=debug)}")
        return 2
    return 0


if __name__ == "__main__":
    entry()
