"""Results on disk: NAME.json with the scores, NAME.npz with the arrays, both whole or absent."""

import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from keycld._errors import KeycldError
from keycld._files import replacing_both
from keycld._lock import alone
from keycld._records import Unexpected, damaged, read_arrays, read_json
from keycld.evaluation.outcome import Evaluation
from keycld.evaluation.stored import check_arrays, checked_scores, layout, required


def save_evaluation(folder: str | Path, name: str, evaluation: Evaluation) -> Path:
    """Write `evaluation/NAME.npz` and `evaluation/NAME.json` of a run folder; return the latter's path.

    A result that can be seen is complete, and an old one stays if the new one cannot be written.
    """
    path = Path(folder) / "evaluation" / f"{name}.json"
    with alone(path.parent, "stores results"), replacing_both(path, path.with_suffix(".npz")) as (scores, arrays):
        np.savez_compressed(arrays, allow_pickle=False, **evaluation.arrays)
        scores.write_text(as_json(evaluation.scores) + "\n", encoding="utf-8")
    return path


def load_evaluation(folder: str | Path, name: str) -> Evaluation:
    """Read what `save_evaluation` wrote.

    Raises:
        KeycldError: it is missing or damaged.
    """
    path, fix = Path(folder) / "evaluation" / f"{name}.json", "run `keycld eval` again"
    at_fault = path
    try:
        scores = checked_scores(_migrated(read_json(path, dict[str, Any], fix)))
        expected, at_fault = layout(scores), path.with_suffix(".npz")
        arrays = read_arrays(at_fault, expected, fix)
        if missing := required(scores) - arrays.keys():
            raise Unexpected(f"the array '{min(missing)}' is missing")
        check_arrays(scores, arrays)
    except FileNotFoundError as error:
        raise KeycldError(f"no result '{name}' in '{folder}': run `keycld eval` on this run first.") from error
    except (KeyError, TypeError, ValueError) as error:
        raise error if isinstance(error, KeycldError) else damaged(at_fault, error, fix) from error
    return Evaluation(scores, arrays)


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
