"""`xmarl-bench check explainer|policy|task`: exit code 1 if a check fails."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Annotated

import typer

from xmarl_bench.cli.options import AsJson, TrustCode
from xmarl_bench.counted import counted

if TYPE_CHECKING:
    from xmarl_bench.checks import Finding

check = typer.Typer(
    name="check", help="Check an explainer, a policy or a task before it is scored.", no_args_is_help=True
)


@check.command("explainer")
def check_explainer(
    name: Annotated[str, typer.Argument(help="Explainer name, path/to/file.py:Name or module:Name.")],
    policy: Annotated[
        str | None, typer.Option(help="Policy to explain; by default the first one installed.")
    ] = None,
    timesteps: Annotated[int, typer.Option(min=2, help="States to explain; no score uses them.")] = 20,
    trust_code: TrustCode = False,
    as_json: AsJson = False,
) -> None:
    """Check that an explainer's masks are valid and repeat, without side effects. Exit code 1: one failed."""
    from xmarl_bench.checks.explainer_checks import check_explainer as run
    from xmarl_bench.errors import InputError
    from xmarl_bench.plugins.names import find_policies
    from xmarl_bench.plugins.registry import find_explainer, open_policy
    from xmarl_bench.tasks.sources import open_task

    explainer = find_explainer(name)
    chosen = policy if policy is not None else next(iter(find_policies()), None)
    if chosen is None:
        raise InputError("no policy is installed: give the folder of a policy bundle with --policy.")
    network, card = open_policy(chosen, trust_code=trust_code)
    open_task(card.task, trust_code=trust_code)
    findings = run(explainer, network, card.task, card.n_agents, timesteps)
    report(f"explainer {explainer.name} on {card.name}", findings, as_json=as_json)


@check.command("policy")
def check_policy(
    name: Annotated[str, typer.Argument(help="Policy name, folder or zip of a bundle, or module:factory.")],
    task: Annotated[
        str | None, typer.Option(help="Task, or module:factory; the policy's own by default.")
    ] = None,
    agents: Annotated[int | None, typer.Option(help="Team size; the policy's own by default.")] = None,
    timesteps: Annotated[int, typer.Option(min=2, help="States to try; no score uses them.")] = 20,
    episodes: Annotated[int, typer.Option(help="Episodes to compare with random actions.")] = 20,
    trust_code: TrustCode = False,
    as_json: AsJson = False,
) -> None:
    """Check that agents share one function and interact through messages only. Exit code 1: one failed."""
    from xmarl_bench.checks.policy_checks import check_policy as run
    from xmarl_bench.plugins.registry import open_policy
    from xmarl_bench.rollout.cell import Cell
    from xmarl_bench.scoring.arguments import check_fit
    from xmarl_bench.tasks.sources import open_task

    given = None if task is None else open_task(task, trust_code=trust_code).name
    network, card = open_policy(name, trust_code=trust_code)
    own = open_task(card.task, trust_code=trust_code).name
    cell = Cell(given or own, card.n_agents if agents is None else agents)
    check_fit(card, cell)
    findings = run(network, cell, timesteps=timesteps, episodes=episodes)
    report(f"policy {card.name} with {counted(cell.n_agents, 'agent')}", findings, as_json=as_json)


@check.command("task")
def check_task(
    name: Annotated[str, typer.Argument(help="Task name, path/to/file.py:factory or module:factory.")],
    agents: Annotated[int, typer.Option(help="Team size.")] = 3,
    episodes: Annotated[int, typer.Option(min=2, help="Episodes to play with random actions.")] = 5,
    trust_code: TrustCode = False,
    as_json: AsJson = False,
) -> None:
    """Check that a task can be scored: episodes repeat, and what infos tell; 1 if a check fails."""
    from xmarl_bench.checks.task_checks import check_task as run
    from xmarl_bench.rollout.cell import Cell
    from xmarl_bench.tasks.sources import open_task

    cell = Cell(open_task(name, trust_code=trust_code).name, agents)
    report(
        f"task {cell.task} with {counted(cell.n_agents, 'agent')}",
        run(cell, episodes=episodes),
        as_json=as_json,
    )


def report(subject: str, findings: Iterable[Finding], *, as_json: bool) -> None:
    """Print the findings on `subject`. Raises typer.Exit(1) if a check failed."""
    from xmarl_bench.cli.fitted_table import print_table
    from xmarl_bench.cli.tables import print_json

    found = list(findings)
    failed = sum(finding.passed is False for finding in found)
    if as_json:
        print_json({"subject": subject, "passed": not failed, "findings": [each.record() for each in found]})
    else:
        words = {True: "pass", False: "FAIL", None: "n/a"}
        rows = [
            {"check": each.check, "result": words[each.passed], "finding": each.message} for each in found
        ]
        styles = {"pass": "green", "FAIL": "red", "n/a": "dim"}
        print_table(rows, title=subject, keep=("result", "finding"), styles=styles)
        print(
            f"{subject}: {failed} of {counted(len(found), 'check')} failed."
            if failed
            else f"{subject}: all passed."
        )
    if failed:
        raise typer.Exit(1)
