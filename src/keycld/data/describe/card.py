"""The README.md of a data set: a small paper."""

from typing import Any

from keycld.data.format.trajectories import Trajectories
from keycld.systems import get, names

_MEANING = {
    "train": "what models learn from",
    "validation": "for choices; its mean image gives the threshold ε",
    "test": "nothing is ever tuned on it",
    "test_long": "long predictions with all inputs zero; nothing is ever tuned on it",
    "sweeps": "pictures along paths and a grid of the configuration space, for energy figures",
}

_LATER = "keycld makes it when it is first needed"


def card(train: Trajectories, figures: dict[str, Any]) -> str:
    """Write the card, in Markdown.

    Args:
        train: the first recordings of the training split, with their pictures.
        figures: what `statistics.json` will hold.
    """
    about = train.attributes
    system = get(about["system"]) if about["system"] in names() else None
    parts = [f"# {about['system']}", "![Four recordings side by side](preview.gif)"]
    if system is not None and type(system).__doc__:
        parts.append("\n".join(line.strip() for line in str(type(system).__doc__).strip().splitlines()))
    parts += ["## Files", _files(figures)]
    parts += ["## Fields", _fields(train)]
    parts += ["## How it was made", _origin(about, figures)]
    if "baselines" in figures:
        parts += ["## Parameters and conserved quantity", _ranges(figures)]
        parts += ["## Trivial predictions", _baselines(figures["baselines"])]
    if "baselines" in figures:
        valid = "the first frame after the 64 of a training window whose normalised error exceeds 0.025"
        trivial = "the mean training picture"
    else:
        epsilon = figures["splits"]["validation"].get("epsilon", float("nan"))
        valid = f"the first frame whose mean squared error exceeds ε = {epsilon:.3e}"
        trivial = "the mean image and of the frozen last frame"
    parts += [
        "## How to evaluate",
        f"Valid prediction time: {valid}, as a part of the frames; the model gets the first frames and the input only, "
        f"never `/state`. Report the scores of {trivial} next to every result.",
        "`keycld data check` on this folder compares every file with `statistics.json`.",
    ]
    return "\n\n".join(parts) + "\n"


def _ranges(figures: dict[str, Any]) -> str:
    rows = ["| training set | least | mean | largest |", "|---|---|---|---|"]
    named = {name: values for name, values in figures["parameters"].items() if name != "seed"}
    if "conserved" in figures:
        named["conserved, in the first frame"] = figures["conserved"]
    rows += [f"| {name} | {v['least']:.4g} | {v['mean']:.4g} | {v['largest']:.4g} |" for name, v in named.items()]
    if "conserved" in figures:
        change = figures["conserved"]["largest_change"]
        rows += ["", f"Largest change of the conserved quantity along a recording: {change:.2g}."]
    return "\n".join(rows)


def _baselines(baselines: dict[str, Any]) -> str:
    rows = [
        "| on `test.h5` | normalised error | units of tables 5 and 6 | frames below 0.025 | valid prediction time |",
        "|---|---|---|---|---|",
    ]
    for name, title in (("mean_image", "mean training picture"), ("first_frame", "first frame of the recording")):
        s = baselines[name]
        rows.append(
            f"| {title} | {s['normalised_error']:.4f} | {s['table_units']:.1f} | {s['below_threshold']:.2f} | "
            f"{s['vpt']:.3f} |"
        )
    rows += [
        "",
        'The measures of "Which priors matter?": normalised error Σ (x − x̂)² / Σ x² of a frame; valid prediction time: '
        "the first frame above 0.025, as a part of the recording, here counted from the first frame.",
    ]
    return "\n".join(rows)


def _files(figures: dict[str, Any]) -> str:
    rows = ["| file | recordings × frames | MB | what for |", "|---|---|---|---|"]
    for name, split in figures["splits"].items():
        size = f"{split['bytes'] / 1e6:.1f}"
        meaning = _MEANING.get(name, "")
        rows.append(f"| `{name}.h5` | {split['trajectories']} × {split['frames']} | {size} | {meaning} |")
    for split in figures.get("recipe", {}).get("splits", ()):
        if split["name"] not in figures["splits"]:
            count, meaning = split["seeds"][1] - split["seeds"][0], _MEANING[split["name"]]
            rows.append(f"| `{split['name']}.h5` | {count} × {split['frames']} | – | {meaning}; {_LATER} |")
    return "\n".join(rows)


def _fields(train: Trajectories) -> str:
    about = train.attributes
    lines = []
    if train.image is not None:
        height, width = train.image.shape[2:4]
        absent = (
            f", not stored but rendered from the state by '{about['renderer']}'" if "renderer_version" in about else ""
        )
        lines.append(f"- `/image`: {height} × {width} RGB, one every {about['dt']:g} s{absent}")
    count = train.input.shape[-1]
    unnamed = f"{count} components" if count else "none, nothing drives the motion"
    inputs = ", ".join(about.get("input_names", ())) or unnamed
    lines.append(f"- `/input`: {inputs}")
    if train.state is not None and "state_names" in about:
        units = about.get("units", ("",) * len(about["state_names"]))
        named = ", ".join(f"{name} ({unit})" for name, unit in zip(about["state_names"], units, strict=True))
        lines.append(f"- `/state`, ground truth for evaluation only: {named}")
    return "\n".join(lines)


def _origin(about: Any, figures: dict[str, Any]) -> str:
    lines = [f"- generator: {about.get('generator', 'unknown')}, protocol {about.get('protocol', 'unknown')}"]
    conditions = [
        f"{key} {about[key]}" for key in ("control", "initial_state", "input_limit", "clip", "input") if key in about
    ]
    if conditions:
        lines.append(f"- conditions of train, validation and test: {', '.join(conditions)}")
    if about.get("renderer"):
        lines.append(f"- rendered by {about['renderer']}")
    if "seconds" in figures:
        lines.append(f"- made in {figures['seconds']:.0f} s")
    return "\n".join(lines)
