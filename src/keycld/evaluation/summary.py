"""A result in a few lines of text, next to the trivial baselines."""

from collections.abc import Mapping
from typing import Any

from keycld.evaluation.published import published_vpt


def threshold_text(metric: str, threshold: str) -> str:
    """Return a threshold, the key of a VPT, in words: `ε`, `ε/4`, or `0.025` of the normalised error."""
    if metric == "normalised":
        return threshold
    return {"1": "ε", "0.25": "ε/4"}.get(threshold, f"{threshold} ε")


def setting_text(scores: Mapping[str, Any]) -> str:
    """Return what was given and what was scored, in words."""
    protocol, (first, stop) = scores["protocol"], scores["part"]
    end = "last " if scores["direction"] == "backward" else ""
    words = [
        f"{scores['n']} trajectories of {protocol['horizon']} frames",
        f"the {end or 'first '}{protocol['given']} given",
    ]
    if protocol.get("start", 0):
        words.insert(1, f"taken up at frame {protocol['start']}")
    if stop - first < protocol["horizon"]:
        words.append(f"frames {first} to {stop - 1} scored")
    if scores["direction"] == "backward":
        words.append("backward")
    return ", ".join(words)


def summary(scores: Mapping[str, Any]) -> str:
    """Return the scores of one protocol as a small table: VPT and error of the model and of every baseline.

    A score means little alone: a system that hardly moves is easy for a frozen frame too.
    """
    protocol, thresholds = scores["protocol"], list(scores["vpt"])
    normalised = scores["metric"] == "normalised"
    heads = [f"VPT {threshold_text(scores['metric'], threshold)}" for threshold in thresholds]
    heads += ["train part", "extrapolated"] if normalised else ["MSE"]
    limit = "normalised error" if normalised else f"ε = {scores['epsilon']:.3g}"
    lines = [
        f"{protocol['name']}: {setting_text(scores)}, {limit}",
        f"  {'':24}" + "".join(f"{head:>14}" for head in heads),
        _row("this model", scores, thresholds),
    ]
    lines += [_row(name, values, thresholds) for name, values in scores["baselines"].items()]
    paper = published_vpt(scores)
    if paper:
        lines.append(f"  {'paper: KeyCLD':24}{paper['KeyCLD']:14.2f}")
    mean = scores["vpt"][thresholds[0]]
    lines.append(
        f"  median {mean['median']:.2f}, std {mean['std']:.2f}, "
        f"95 % interval of the mean {mean['interval'][0]:.2f} to {mean['interval'][1]:.2f}"
    )
    if normalised:
        units = ", ".join(f"{name} {_number(value)}" for name, value in scores["table_units"].items())
        lines.append(f"  in the units of tables 5 and 6: {units}")
    if "state" in scores:
        last = ", ".join(
            f"{each['name']} {_number(each['last_median'])} {each['unit']}" for each in scores["state"]["coordinates"]
        )
        lines.append(f"  keypoint residual {_number(scores['state']['residual'])}; median error at the end: {last}")
        lines += [f"  {line}" for line in _law(scores["state"])]
    if "drift" in scores:
        drift = {"energy": "mean", "constraint": "worst"}
        known = [
            f"{name} {_number(scores['drift'][name][kind])}" for name, kind in drift.items() if name in scores["drift"]
        ]
        lines.append(f"  drift: {', '.join(known)}")
    return "\n".join(lines)


def _law(state: Mapping[str, Any]) -> list[str]:
    """Return what is known of the learned law: these scores do not depend on where the motion begins."""
    found, rates = [], state.get("friction")
    if state.get("acceleration") is not None:
        found.append(f"acceleration {_number(100 * state['acceleration'])} % from the true one, rms")
    if rates:
        found.append(f"friction takes energy at {_number(rates['found'])} /s (true {_number(rates['true'])})")
    return [f"law: {'; '.join(found)}"] if found else []


def _row(name: str, scores: Mapping[str, Any], thresholds: list[str]) -> str:
    vpt = "".join(f"{scores['vpt'][threshold]['mean']:14.3f}" for threshold in thresholds)
    parts = scores.get("normalised_error")
    shown, names = (scores, ["mse"]) if parts is None else (parts, ["train", "extrapolation"])
    errors = [_number(shown[each]) if each in shown else "–" for each in names]
    return f"  {name:24}{vpt}" + "".join(f"{error:>14}" for error in errors)


def _number(value: float | None) -> str:
    return "not finite" if value is None else f"{value:.3g}"
