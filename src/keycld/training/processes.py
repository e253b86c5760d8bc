"""Processes that train one model together, each on its own devices, also on several machines: `jax.distributed`."""

import atexit
import contextlib
import hashlib
import io
import os
import shutil
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.experimental import multihost_utils
from jaxtyping import PyTree

from keycld._errors import KeycldError
from keycld._files import hidden_folder


def join(coordinator: str, processes: int | None, process: int | None) -> None:
    """Join the processes of a training, before anything else is done with JAX.

    Args:
        coordinator: ADDRESS:PORT of the first process, or `"auto"`: Slurm, Open MPI or Kubernetes say all.
        processes: how many there are.
        process: the number of this one, from 0.

    Raises:
        KeycldError: the numbers are missing or wrong, or the others are not found in five minutes.
    """
    numbers = {"coordinator_address": coordinator, "num_processes": processes, "process_id": process}
    if coordinator == "auto":
        numbers = {}
    elif ":" not in coordinator:
        raise KeycldError(f"--coordinator is ADDRESS:PORT of process 0, or auto, not '{coordinator}'.")
    elif processes is None or process is None:
        raise KeycldError(
            f"--coordinator {coordinator} needs --processes, the number of all processes, and --process, that of this "
            "one, from 0."
        )
    elif not 0 <= process < processes:
        raise KeycldError(f"--process is at least 0 and below --processes, not {process} of {processes}.")
    # It would catch the signal that ends a process, and only take note of it.
    jax.config.update("jax_enable_preemption_service", False)
    try:
        jax.distributed.initialize(**numbers)
    except (RuntimeError, ValueError) as error:
        reason = str(error).strip().splitlines()[0]
        raise KeycldError(f"the processes have not found each other at {coordinator}: {reason}") from error


def leads() -> bool:
    """Return whether this process writes the run folder: the first one, or the only one."""
    return jax.process_index() == 0


def check_equal(text: str, what: str) -> None:
    """Refuse processes that were given different things.

    Args:
        text: what must be the same.
        what: its name.

    Raises:
        KeycldError: it is not the same in all of them.
    """
    if jax.process_count() == 1:
        return
    digest = np.frombuffer(hashlib.sha256(text.encode()).digest(), np.uint8)
    others = multihost_utils.process_allgather(digest)
    different = [k for k, other in enumerate(others) if not np.array_equal(other, others[0])]
    if different:
        raise KeycldError(
            f"process {different[0]} has other {what} than process 0: start all with the same command, on machines of "
            "one kind, with the same data."
        )


def check_first(problem: KeycldError | None) -> None:
    """Raise in all processes what the first one met where it was alone."""
    if agreed_number(float(problem is not None)):
        raise problem or KeycldError("process 0 could not open the run folder, and says why.")


def agreed(tree: PyTree) -> PyTree:
    """Return the first process's arrays, bit for bit: what each has computed for itself may differ by rounding.

    Raises:
        KeycldError: the pytrees have different structures or shapes.
    """
    if jax.process_count() == 1:
        return tree
    arrays, rest = eqx.partition(tree, eqx.is_array)
    leaves, structure = jax.tree.flatten(arrays)
    check_equal(f"{structure} {[(leaf.shape, leaf.dtype) for leaf in leaves]}", "laws of motion")
    values = [np.asarray(leaf) for leaf in leaves]
    # As bytes, because JAX has 32 bits for each number.
    got = _of_first(b"".join(each.tobytes() for each in values))
    ends = np.cumsum([0, *(each.nbytes for each in values)])
    taken = [
        jnp.asarray(np.frombuffer(got[begin:end], each.dtype).reshape(each.shape))
        for begin, end, each in zip(ends[:-1], ends[1:], values, strict=True)
    ]
    return eqx.combine(jax.tree.unflatten(structure, taken), rest)


def agreed_number(number: float) -> float:
    """Return the first process's number, with all its bits."""
    return number if jax.process_count() == 1 else float(np.frombuffer(_of_first(np.float64(number).tobytes()))[0])


@contextlib.contextmanager
def own_folder(folder: Path) -> Iterator[Path]:
    """Give each process but the first a folder of its own, which vanishes: one writes the run folder, all resume it.

    The others have a copy of the newest checkpoints, and print nothing: what they would say, the first one says.

    Args:
        folder: the run folder, which all processes see.

    Raises:
        KeycldError: another process has ended.
    """
    if jax.process_count() == 1:
        yield folder
        return
    with contextlib.ExitStack() as held:
        mine = folder
        try:
            multihost_utils.sync_global_devices("the run folder is open")
            if not leads():
                mine = held.enter_context(hidden_folder(Path(tempfile.gettempdir()) / "keycld-process"))
                if (folder / "checkpoints").exists():
                    shutil.copytree(folder / "checkpoints", mine / "checkpoints")
            multihost_utils.sync_global_devices("every process has its checkpoint")
            if not leads():
                held.enter_context(contextlib.redirect_stdout(io.StringIO()))
                held.enter_context(contextlib.redirect_stderr(io.StringIO()))
            yield mine
        except Exception as error:
            atexit.register(_leave)
            if not isinstance(error, jax.errors.JaxRuntimeError):
                raise
            first = str(error).strip().splitlines()[0]
            raise KeycldError(
                f"a process of this training has ended, or cannot be reached ({first}): start all of them again with "
                "the same commands, which continue from the newest checkpoint."
            ) from error


def _leave() -> None:
    """End this process: JAX would wait for the others, which wait for this one, or abort."""
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(2)


def _of_first(sent: bytes) -> bytes:
    """Return what the first process sends; all send as many bytes."""
    return np.asarray(multihost_utils.broadcast_one_to_all(np.frombuffer(sent, np.uint8))).tobytes()
