"""Physical constants as text."""

import math

from keycld.evaluation.physics_file import Constant, Physics, pieces_note


def value_text(constant: Constant) -> str:
    """Return the value of a constant, with as many decimals as two figures of its error have, and this error."""
    value, sigma = constant["value"], constant["sigma"]
    if value is None:
        return "not identifiable"
    if not sigma:
        return f"{value:.5g}"
    digits = max(0, 1 - math.floor(math.log10(sigma)))
    return f"{value:.{digits}f} ± {sigma:.{digits}f}"


def constants_table(physics: Physics) -> str:
    """Return the constants, one on each line: name, value, error and unit, or why there is no value."""
    width = max((len(name) for name in physics["constants"]), default=0)
    lines = []
    for name, constant in physics["constants"].items():
        unit = "" if constant["unit"] == "1" else f" {constant['unit']}"
        rest = unit if constant["value"] is not None else f": {constant.get('note', 'the recordings do not tell it')}"
        lines.append(f"{name:{width}}  {value_text(constant)}{rest}")
    return "\n".join(lines)


def physics_table(physics: Physics) -> str:
    """Return the constants with their error bars, what was rejected, and the prediction, a line each."""
    lines = [text for text in (constants_table(physics), pieces_note(physics), physics.get("note")) if text]
    for kind, rejected in physics["rejected"].items():
        lines.append(f"rejected: {kind}, worth {rejected['worth']:.2g} of the cost, needed {rejected['needed']:.2g}")
    if physics["prediction"]:
        lines.append("prediction: " + ", ".join(f"{name} {_plain(v)}" for name, v in physics["prediction"].items()))
    return "\n".join(lines)


def _plain(value: object) -> str:
    if isinstance(value, list):
        return " ".join(_plain(each) for each in value)
    return f"{value:.3g}" if isinstance(value, float) else str(value)
