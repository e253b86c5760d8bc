"""A result in a few lines of text, the trivial baselines beside it."""

from collections.abc import Mapping
from typing import Any

from keycld.evaluation.published import PAPER_VPT


def summary(scores: Mapping[str, Any]) -> str:
    """The scores of one protocol as a small table: VPT and MSE of the model and of every baseline.

    A score means little alone: a system that hardly moves is easy for a frozen frame too.
    """
    protocol, system = scores["protocol"], scores["system"]
    factors = list(scores["vpt"])
    heads = [f"VPT {'' if factor == '1' else factor + ' '}ε" for factor in factors]
    lines = [
        f"{protocol['name']}: {scores['n']} trajectories of {protocol['horizon']} frames, "
        f"{protocol['given']} given, ε = {scores['epsilon']:.3g}",
        f"  {'':24}" + "".join(f"{head:>12}" for head in heads) + f"{'MSE':>12}",
        _row("this model", scores, factors),
    ]
    lines += [_row(name, values, factors) for name, values in scores["baselines"].items()]
    paper = PAPER_VPT.get(system)
    if paper and protocol["horizon"] == 50 and protocol["given"] == 2:
        lines.append(f"  {'paper: KeyCLD':24}{paper['KeyCLD']:12.2f}")
    mean = scores["vpt"][factors[0]]
    lines.append(
        f"  median {mean['median']:.2f}, std {mean['std']:.2f}, "
        f"95 % interval of the mean {mean['interval'][0]:.2f} to {mean['interval'][1]:.2f}"
    )
    if "state" in scores:
        last = ", ".join(
            f"{each['name']} {_number(each['last_median'])} {each['unit']}" for each in scores["state"]["coordinates"]
        )
        lines.append(f"  keypoint residual {_number(scores['state']['residual'])}; median error at the end: {last}")
    if "drift" in scores:
        drift = [f"energy {_number(scores['drift']['energy']['mean'])}"]
        if "constraint" in scores["drift"]:
            drift.append(f"constraints {_number(scores['drift']['constraint']['worst'])}")
        lines.append(f"  drift: {', '.join(drift)}")
    return "\n".join(lines)


def _row(name: str, scores: Mapping[str, Any], factors: list[str]) -> str:
    vpt = "".join(f"{scores['vpt'][factor]['mean']:12.3f}" for factor in factors)
    return f"  {name:24}{vpt}{_number(scores['mse']):>12}"


def _number(value: float | None) -> str:
    return "not finite" if value is None else f"{value:.3g}"
