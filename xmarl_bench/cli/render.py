"""`xmarl-bench render`."""

from __future__ import annotations

from math import isnan
from pathlib import Path
from typing import Annotated

import typer

from xmarl_bench.cli.options import MaxCycles, TrustCode


def render(
    task: Annotated[
        str | None, typer.Option(help="Task, or module:factory; the policy's own by default.")
    ] = None,
    policy: Annotated[
        str, typer.Option(help="Policy name or folder of a policy bundle, 'heuristic' or 'random'.")
    ] = "heuristic",
    explainer: Annotated[
        list[str], typer.Option(help="Explainer to draw over the team. Repeatable: side by side.")
    ] = [],  # noqa: B006
    agents: Annotated[int | None, typer.Option(help="Team size; the policy's own by default, or 3.")] = None,
    seed: Annotated[int, typer.Option(help="Seed of a `score` run, which plays the same episodes.")] = 0,
    episode: Annotated[int, typer.Option(help="Number of the episode in that run, from 0.")] = 0,
    max_cycles: MaxCycles = None,
    trust_code: TrustCode = False,
    out: Annotated[
        Path,
        typer.Option(help="File to write: .gif, .mp4, .png, a sheet of six moments, or .avif, one of 24."),
    ] = Path("episode.gif"),
) -> None:
    """Draw an episode, and an explainer's masks over it: who influences whom."""
    from xmarl_bench.plugins.registry import find_explainer
    from xmarl_bench.render.animation import check_target, write_animation
    from xmarl_bench.render.recording import record
    from xmarl_bench.render.team import select_team

    check_target(out)
    network, name, cell = select_team(policy, task, agents, trust_code=trust_code)
    chosen = [find_explainer(each) for each in explainer]
    recording = record(cell.make(), name, network, seed=seed, episode=episode, max_cycles=max_cycles)
    written = write_animation(recording, out, *chosen, progress=True)
    last = recording.track.scene()
    success = "" if isnan(recording.success_rate) else f"success {recording.success_rate:.2f}, "
    print(
        f"{out}: {written.frames} of {last.cycle + 1} moments of episode {recording.seed}, "
        f"{written.n_bytes / 1e6:.2f} MB; {last.ended}, {success}"
        f"return {last.total:.2f}."
    )
