"""Results on disk: NAME.json with the scores, NAME.npz with the arrays, both whole or absent."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from keycld._errors import KeycldError
from keycld._files import replacing, write_text
from keycld.evaluation.evaluate import Evaluation


def save_evaluation(folder: str | Path, name: str, evaluation: Evaluation) -> Path:
    """Write `evaluation/NAME.npz` and `evaluation/NAME.json` of a run folder; return the latter's path.

    An old JSON is removed before the arrays are replaced and the new one is written last, so a result that can be seen
    is complete.
    """
    path = Path(folder) / "evaluation" / f"{name}.json"
    with replacing(path.with_suffix(".npz")) as temporary:
        np.savez_compressed(temporary, allow_pickle=False, **evaluation.arrays)
        path.unlink(missing_ok=True)
    write_text(path, as_json(evaluation.scores) + "\n")
    return path


def load_evaluation(folder: str | Path, name: str) -> Evaluation:
    """Read what `save_evaluation` wrote.

    Raises:
        KeycldError: it is missing or damaged.
    """
    path = Path(folder) / "evaluation" / f"{name}.json"
    try:
        scores = json.loads(path.read_text())
        with np.load(path.with_suffix(".npz"), allow_pickle=False) as archive:
            return Evaluation(_migrated(scores), dict(archive))
    except FileNotFoundError as error:
        raise KeycldError(f"no result '{name}' in '{folder}': run `keycld eval` on this run first.") from error
    except Exception as error:
        raise KeycldError(f"the result '{path}' is damaged ({error}): run `keycld eval` again.") from error


def as_json(scores: dict[str, Any]) -> str:
    """Return scores as JSON; numbers that are not finite become null."""
    return json.dumps(_plain(scores), indent=1, allow_nan=False)


def _migrated(scores: dict[str, Any]) -> dict[str, Any]:
    """Return scores with what results of version 0.1 do not say: all frames, forward, against ε."""
    if "protocol" not in scores or "metric" in scores:
        return scores
    usual = {"metric": "squared", "direction": "forward", "threshold": scores["epsilon"]}
    return {**scores, **usual, "part": [0, scores["protocol"]["horizon"]]}


def _plain(value: Any) -> Any:
    """Return the value with NumPy numbers as Python ones and without anything that JSON does not know."""
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, np.ndarray | np.generic):
        return _plain(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
