"""The sections on the run itself: training, configuration, how to reproduce it."""

from pathlib import Path

from keycld.drawing import save_figure
from keycld.reports import html
from keycld.reports.run import Run
from keycld.reports.training_figure import terms, training_figure


def verdict(run: Run) -> str:
    """Say what failed in each attempt of a training."""
    attempts = "".join(f"<li>{html.text(failure)}</li>" for failure in run.failures)
    note = f"This training has failed {len(run.failures)} times, each with other initial weights: there is no model."
    return html.section("verdict", "Failed", html.paragraph(note) + f"<ol>{attempts}</ol>")


def training(run: Run) -> str:
    """Show curves from metrics.jsonl, and why the training began again if it did."""
    figure = training_figure(run.metrics)
    if figure is None:
        return html.missing("training", "Training", "metrics.jsonl is absent or empty")
    save_figure(run.folder / "media" / "training.png", figure)
    last = run.metrics[-1]
    facts = [f"{last['step']:,} steps".replace(",", " ")]
    if "frames" in last:
        facts.append(f"{last['frames']:,} pictures through the networks".replace(",", " "))
    if "seconds" in last:
        facts.append(f"{last['seconds'] / 60:.1f} minutes")
    if "cpu_seconds" in last:
        facts.append(f"{last['cpu_seconds'] / 60:.1f} CPU minutes")
    stages = list(dict.fromkeys(str(line.get("stage")) for line in run.metrics))
    note = f"{', '.join(facts)}, in {len(stages)} stages: {html.text(', '.join(stages))}."
    once = [
        f"{html.text(name.replace('_', ' '))} {html.number(lines[0][name])}"
        for name, lines in terms(run.metrics).items()
        if len(lines) == 1
    ]
    if once:
        note += f" Measured once: {', '.join(once)}."
    if run.failures and not run.failed:
        note += f" It began again with other initial weights: {html.text(' '.join(run.failures))}"
    chart = html.figure(
        html.chart(figure, "training"),
        "Loss terms and scores; a hairline is the first step of a stage. Each stage has a loss of its own. The weights "
        "of its terms change with the steps, and its predictions become longer, so that a rise alone is no failure.",
    )
    return html.section("training", "Training", html.paragraph(note) + chart)


def reproduction(run: Run) -> str:
    """Show the command, the configuration and the environment."""
    parts = []
    command = run.config.get("command")
    if command:
        parts.append(html.paragraph("On the same machine and with the same versions this command gives the same bits."))
        program, *arguments = str(command).split(" ")
        parts.append(f"<pre><code>{html.text(' '.join([Path(program).name, *arguments]))}</code></pre>")
    rest = {name: value for name, value in run.config.items() if name != "command"}
    parts.append(f"<details><summary>Configuration</summary>{html.pairs(rest)}</details>")
    if run.environment:
        parts.append(f"<details><summary>Environment</summary>{html.pairs(run.environment)}</details>")
    return html.section("reproduce", "Reproduce", "".join(parts))
