"""The verb `keycld models`."""

import json
from typing import Annotated

import tyro


def models(*, as_json: Annotated[bool, tyro.conf.arg(name="json")] = False) -> None:
    """List the models that can be trained, with families, presets, capabilities and sizes.

    Parameters are counted at 32 × 32 pixels without inputs, in the default preset; KeyCLD's with one keypoint.

    Args:
        as_json: Print a JSON list instead of a table.
    """
    from keycld.models.listing import listing

    rows = listing()
    if as_json:
        print(json.dumps(rows, indent=1))
        return
    width = max(len(row["name"]) for row in rows)
    for row in rows:
        print(f"{row['name']:{width}}  {row['title']}")
        print(f"{'':{width}}  family {row['family']}; presets {', '.join(row['presets'])}")
        print(f"{'':{width}}  {row['parameters']:,} parameters; {', '.join(row['capabilities']) or 'predicts only'}\n")
    print("next: keycld train DATA --model NAME --preset PRESET --help lists all settings of a preset.")
