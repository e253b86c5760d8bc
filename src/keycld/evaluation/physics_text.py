"""Physical constants as text."""

import math

from keycld.evaluation.physics_file import Physics, pieces_note


def physics_table(physics: Physics) -> str:
    """Return the constants with their error bars, what was rejected, and the prediction, a line each."""
    lines = []
    width = max((len(name) for name in physics["constants"]), default=0)
    for name, constant in physics["constants"].items():
        value, sigma, unit = constant["value"], constant["sigma"], constant["unit"]
        if value is None:
            note = constant.get("note", "these recordings do not determine it")
            lines.append(f"{name:{width}}  not identifiable: {note}")
            continue
        shown = f"{value:.6g}" if not sigma else f"{_rounded(value, sigma)} ± {sigma:.2g}"
        lines.append(f"{name:{width}}  {shown} {'' if unit == '1' else unit}".rstrip())
    lines += [note for note in (pieces_note(physics), physics.get("note")) if note]
    for kind, rejected in physics["rejected"].items():
        lines.append(f"rejected: {kind}, worth {rejected['worth']:.2g} of the cost, needed {rejected['needed']:.2g}")
    if physics["prediction"]:
        lines.append("prediction: " + ", ".join(f"{name} {_plain(v)}" for name, v in physics["prediction"].items()))
    return "\n".join(lines)


def _rounded(value: float, sigma: float) -> str:
    """Return the value with as many decimals as two figures of its error have."""
    digits = max(0, 1 - math.floor(math.log10(sigma)))
    return f"{value:.{digits}f}"


def _plain(value: object) -> str:
    if isinstance(value, list):
        return " ".join(_plain(each) for each in value)
    return f"{value:.3g}" if isinstance(value, float) else str(value)
