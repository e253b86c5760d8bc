"""Write the tables of the documentation that follow from the registry: `python scripts/docs_tables.py`.

Each table stands between two comments of a page, `<!-- NAME: … -->` and `<!-- end of NAME -->`.
"""

import ast
import dataclasses
import inspect
import sys
import typing
from pathlib import Path

import tyro

from keycld.models import ModelConfig, models

COMMAND = "python scripts/docs_tables.py"
DOCS = Path(__file__).parents[1] / "docs"


def models_table() -> str:
    """Return name, family, presets, capabilities and size of each registered model."""
    from keycld.models.listing import listing

    rows = [
        [
            f"`{row['name']}`",
            row["title"],
            f"`{row['family']}`",
            ", ".join(f"`{preset}`" for preset in row["presets"]),
            ", ".join(row["capabilities"]) or "prediction only",
            f"{row['parameters']:,}",
        ]
        for row in listing()
    ]
    return _table(["model", "what it is", "family", "presets", "can also do", "parameters"], rows)


def settings_tables() -> str:
    """Return the settings of all presets: a table for each group of models, and of presets that share a config."""
    titles: dict[str, list[str]] = {}
    for model, entry in models().items():
        for presets in _related(entry.presets):
            titles.setdefault(_settings_table(presets), [", ".join(f"`{name}`" for name in presets)]).append(model)
    return "\n\n".join(
        f"**{presets}** ({', '.join(f'`{name}`' for name in names)})\n\n{table}"
        for table, (presets, *names) in titles.items()
    )


def _related(presets: dict[str, ModelConfig]) -> list[dict[str, ModelConfig]]:
    """Return presets in groups whose configs derive from that of the first one."""
    groups: list[dict[str, ModelConfig]] = []
    for name, config in presets.items():
        home = [group for group in groups if isinstance(config, type(next(iter(group.values()))))]
        if home:
            home[0][name] = config
        else:
            groups.append({name: config})
    return groups


def _settings_table(presets: dict[str, ModelConfig]) -> str:
    """Return the settings of some presets: a row for each name and meaning, a column for each preset."""
    rows: dict[tuple[str, str], dict[str, str]] = {}
    for preset, config in presets.items():
        for name, value, meaning in _settings(config):
            rows.setdefault((name, meaning), {})[preset] = value
    cells = [[f"`{name}`", *(values.get(p, "") for p in presets), meaning] for (name, meaning), values in rows.items()]
    return _table(["setting", *(f"`{preset}`" for preset in presets), "meaning"], cells)


def _settings(config: typing.Any, prefix: str = "") -> list[tuple[str, str, str]]:
    """Return name, value and meaning of the settings that are flags of `keycld train`."""
    kinds, meanings, found = typing.get_type_hints(type(config), include_extras=True), _meanings(type(config)), []
    for field in dataclasses.fields(config):
        value, name = getattr(config, field.name), prefix + field.name
        if tyro.conf.Suppress in typing.get_args(kinds[field.name]):
            continue
        if dataclasses.is_dataclass(value):
            found += _settings(value, f"{name}.")
        else:
            found.append((name, _text(value), meanings[field.name]))
    return found


def _meanings(kind: type) -> dict[str, str]:
    """Return the line of documentation below each field of a dataclass."""
    found = {}
    for base in reversed(kind.__mro__):
        if dataclasses.is_dataclass(base):
            [definition] = ast.parse(inspect.getsource(base).lstrip()).body
            assert isinstance(definition, ast.ClassDef)
            for field, text in zip(definition.body, definition.body[1:], strict=False):
                match field, text:
                    case ast.AnnAssign(target=ast.Name(id=name)), ast.Expr(value=ast.Constant(value=str(words))):
                        found[name] = " ".join(words.split())
    return found


def _text(value: object) -> str:
    if isinstance(value, tuple):
        return " ".join(map(_text, value))
    return str(value).lower() if isinstance(value, bool) else str(value)


def _table(head: list[str], rows: list[list[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines)


TABLES = {"models": ("models.md", models_table), "settings": ("training.md", settings_tables)}
"""Page and content of each table, by name."""


def split(page: str, name: str) -> tuple[str, str, str]:
    """Return what is before, in and after a table of a page."""
    before, first, rest = page.partition(f"<!-- {name}: written by `{COMMAND}` -->\n")
    table, last, after = rest.partition(f"\n<!-- end of {name} -->")
    if not (first and last):
        raise ValueError(f"no table '{name}'")
    return before + first, table, last + after


def main() -> int:
    """Write all tables."""
    for name, (file, content) in TABLES.items():
        path = DOCS / file
        before, _, after = split(path.read_text(), name)
        path.write_text(f"{before}{content()}{after}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
