"""A flag for XLA without which some versions of jaxlib compute wrong numbers on CPUs."""

import importlib.metadata
import os

_FLAG = "--xla_cpu_experimental_ynn_fusion_type"


def avoid_faulty_kernels() -> None:
    """Keep XLA's CPU compiler from giving reductions to YNNPACK, by the environment variable `XLA_FLAGS`.

    jaxlib 0.10.2 and 0.11 do so by default. Sums over products of long arrays are then wrong by up to a per cent,
    silently (jax-ml/jax, issue 39103), and sums in arrays of seven dimensions, one of size 1, such as those of a
    least-squares fit to a single recording, stop the process with signal 11 (issues 39257 and 40412).

    Matrix products stay there: they are right. A training step takes as long as before, within 4 %.

    It has an effect before the first computation of the process. A value of the flag that is set already stays. jaxlib
    0.12 and newer are left alone: a flag that it does not know stops a process.
    """
    try:
        version = importlib.metadata.version("jaxlib")
    except importlib.metadata.PackageNotFoundError:
        return
    flags = os.environ.get("XLA_FLAGS", "")
    if version.startswith(("0.10.", "0.11.")) and _FLAG not in flags:
        os.environ["XLA_FLAGS"] = f"{flags} {_FLAG}=-reduce".strip()
