"""The command line: finds the verb, then parses its arguments, then imports what it needs."""

import os
import sys
import warnings
from collections.abc import Callable, Sequence

import tyro

from keycld import KeycldError, __version__
from keycld._errors import unknown
from keycld.cli import data, demo, evaluate, info, predict, report, train


def data_sets() -> None:
    """Make, check, look at or import data sets: see `keycld data --help`."""
    main(["data", "--help"])


VERBS: dict[str, Callable] = {
    "demo": demo.demo,
    "data": data_sets,
    "train": train.train,
    "eval": evaluate.evaluate,
    "predict": predict.predict,
    "report": report.report,
    "info": info.info,
}
DATA_VERBS: dict[str, Callable] = {
    "make": data.make,
    "check": data.check,
    "show": data.show,
    "import": data.import_,
}
DESCRIPTION = f"""keycld {__version__}: learn the physics of a moving thing from video, then predict and control it.

Start with `keycld demo`. Then: `keycld data make cartpole`, `keycld train cartpole`, `keycld eval RUN`,
`keycld report RUN`. `keycld data VERB --help` lists what can be done with data sets."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs one verb; returns the exit code: 0, 2 for a mistake the user can mend, 130 when interrupted."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    # JAX would take three quarters of a GPU's memory at its first use and leave none to a renderer.
    os.environ.setdefault("XLA_PYTHON_CLIENT_PREALLOCATE", "false")
    # JAX warns at every child process; ours are ffmpeg and fresh interpreters, which start with exec.
    warnings.filterwarnings("ignore", "os.fork", RuntimeWarning)
    try:
        verbs, prog, description = VERBS, "keycld", DESCRIPTION
        if words[:1] == ["data"]:
            words, verbs, prog = words[1:], DATA_VERBS, "keycld data"
            description = "Make, check, look at and import data sets."
        elif words[:1] in (["--version"], ["-V"]):
            print(__version__)
            return 0
        if words and not words[0].startswith("-") and words[0] not in verbs:
            raise unknown("verb", words[0], verbs)
        tyro.extras.subcommand_cli_from_dict(
            verbs,
            prog=prog,
            description=description,
            args=words or ["--help"],
            config=(tyro.conf.OmitArgPrefixes,),
        )
    except KeycldError as error:
        print(f"keycld: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("\nkeycld: interrupted; the same command goes on from where it was.", file=sys.stderr)
        return 130
    return 0


def entry() -> None:
    """What the installed command `keycld` calls."""
    sys.exit(main())


if __name__ == "__main__":
    entry()
