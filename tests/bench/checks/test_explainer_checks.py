"""Every check passes valid explainers and fails invalid ones with a message."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor
from torch_geometric.explain import GraphMaskExplainer

from tests.conftest import MakeBundle, RunCli
from tests.helpers.deep_policies import with_a_lonely_timestep
from tests.helpers.example_plugins import BAD
from tests.helpers.policies import random_observations, small_policy
from xmarl_bench import as_explainer
from xmarl_bench.checks import Finding, explainer_checks, run_checks
from xmarl_bench.checks.explainer_checks import CHECKS, check_explainer
from xmarl_bench.checks.explainer_subject import ExplainerSubject
from xmarl_bench.checks.peak_memory import peak_memory
from xmarl_bench.explain.explainer import Explainer
from xmarl_bench.explain.simulator import Simulator
from xmarl_bench.policy import GraphPolicy, Policy

PROCESS = "another process, same mask"
CALLS = [0]


def found(thing: object, *only: str, **declared: Any) -> dict[str, Finding]:
    """Run all checks, but the one that starts another process only on request."""
    explainer = thing if isinstance(thing, Explainer) else as_explainer(thing, **declared)
    subject = ExplainerSubject(explainer, small_policy(6), random_observations(6, 3, 6))
    chosen = {name: CHECKS[name] for name in only or CHECKS if only or name != PROCESS}
    return {each.check: each for each in run_checks(chosen, subject)}


def failed(thing: object, *only: str, **declared: Any) -> dict[str, str]:
    return {
        name: each.message for name, each in found(thing, *only, **declared).items() if each.passed is False
    }


def distant(observations: Tensor, policy: Policy) -> Tensor:
    return torch.sigmoid(torch.cdist(observations[..., :2], observations[..., :2]))


@pytest.mark.slow
def test_what_a_mask_holds_where_the_graph_has_no_edge_does_not_count() -> None:
    policy, observations, _ = with_a_lonely_timestep()
    subject = ExplainerSubject(as_explainer(distant), policy, observations)
    names = "same seed, same mask", "another seed", "order of timesteps", "chunks of timesteps"
    found = run_checks({name: CHECKS[name] for name in names}, subject)
    assert [each.message for each in found if each.passed is False] == []


def attended(observations: Tensor, policy: Policy) -> Tensor:
    return policy.attention(observations)


def attended_one(observations: Tensor, policy: Policy) -> Tensor:
    return policy.attention(observations[None])[0]


def noisy(observations: Tensor, policy: Policy, generator: torch.Generator) -> Tensor:
    return policy.attention(observations) * torch.rand(len(observations), 1, 1, generator=generator)


@pytest.mark.slow
def test_what_plays_on_is_checked_in_the_world_of_one_episode() -> None:
    def ahead(observations: Tensor, policy: Policy, simulator: Simulator) -> Tensor:
        position = torch.from_numpy(simulator.restart(policy, observations).state.position).float()
        return policy.attention(observations) * torch.exp(-torch.cdist(position, position))

    findings = check_explainer(as_explainer(ahead), small_policy(6), "blind_navigation_v0", 3, 6)
    by_name = {each.check: each for each in findings}
    assert [name for name, each in by_name.items() if each.passed is False] == []
    assert by_name["other team sizes"].message == "its simulator is that of a team of 3."
    assert "these states have none" in by_name["follows the receiver"].message


@pytest.mark.slow
def test_valid_explainers_pass() -> None:
    assert failed(attended) == {}
    assert failed(attended, accesses="attention") == {}
    assert failed(attended_one, batched=False) == {}
    signed = found(lambda observations, policy: 2.0 * policy.attention(observations) - 1.0, signed=True)
    assert all(each.passed for each in signed.values()), signed
    assert "normalised by the harness" in signed["range"].message
    one = found(noisy, stochastic=True)
    assert all(each.passed is not False for each in one.values())
    assert one["order of timesteps"].passed is None


@pytest.mark.parametrize("name", sorted(BAD))
def test_invalid_masks_fail_the_right_check(name: str) -> None:
    findings = found(BAD[name])
    first = next(each for each in findings.values() if each.passed is False)
    assert repr(name) in first.message
    where = {"nan": "finiteness", "late-nan": "finiteness", "infinite": "finiteness", "too-large": "range",
             "negative": "range"}  # fmt: skip
    assert first.check == where.get(name, "shape")
    assert findings["memory"].passed is None  # no mask to measure


def count(observations: Tensor) -> Tensor:
    CALLS[0] += 1
    return torch.full((len(observations), 3, 3), 1 / CALLS[0])


def zeroed(observations: Tensor, policy: Policy) -> Tensor:
    mask = policy.attention(observations)
    with torch.no_grad():
        next(iter(policy.parameters())).zero_()
    return mask


def hooked(observations: Tensor, policy: Policy) -> Tensor:
    assert isinstance(policy, GraphPolicy)
    policy.gat.register_forward_hook(lambda *_: None)
    policy.gat.register_message_forward_hook(lambda *_: None)
    return policy.attention(observations)


def differentiated(observations: Tensor, policy: Policy) -> Tensor:
    policy.distribution(observations).action.sum().backward()
    return policy.attention(observations)


def written(observations: Tensor, policy: Policy) -> Tensor:
    mask = policy.attention(observations.clone())
    observations.zero_()
    return mask


def drawing(library: Callable[[], object]) -> Callable[[Tensor, Policy], Tensor]:
    def explain(observations: Tensor, policy: Policy) -> Tensor:
        library()
        return policy.attention(observations)

    return explain


def by_batch(observations: Tensor, policy: Policy) -> Tensor:
    mask = policy.attention(observations)
    return mask / mask.amax()


def by_position(observations: Tensor, policy: Policy) -> Tensor:
    return policy.attention(observations) * torch.linspace(0.5, 1, len(observations))[:, None, None]


@pytest.fixture
def few_timed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Times twelve timesteps instead of a hundred, because `slow` waits for each."""
    monkeypatch.setattr(explainer_checks, "TIMED_TIMESTEPS", 12)


def slow(observations: Tensor, policy: Policy) -> Tensor:
    until = time.process_time() + 0.025 * len(observations)
    while time.process_time() < until:
        pass
    return policy.attention(observations)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("thing", "check", "said"),
    [
        (count, "same seed, same mask", "keep no state between calls"),
        (noisy, "another seed", "declare stochastic = True"),
        (zeroed, "policy untouched", "weights"),
        (hooked, "policy untouched", "hooks"),
        (differentiated, "policy untouched", "gradients"),
        (written, "observations untouched", "wrote into"),
        (drawing(lambda: torch.rand(1)), "global random state untouched", "of torch"),
        (drawing(lambda: np.random.rand(1)), "global random state untouched", "of numpy"),  # noqa: NPY002
        (drawing(lambda: __import__("random").random()), "global random state untouched", "of Python"),
        (drawing(lambda: torch.set_num_threads(2)), "global random state untouched", "number of threads"),
        (by_batch, "chunks of timesteps", "in two halves"),
        (by_position, "order of timesteps", "in another order"),
        (lambda observations: torch.ones(len(observations), 3, 3), "other team sizes", "shape (2, 1, 1)"),
        (slow, "time per timestep", "declare slow = True"),
    ],
)  # fmt: skip
@pytest.mark.usefixtures("few_timed")
def test_every_check_can_fail(thing: Callable[..., Tensor], check: str, said: str) -> None:
    threads = torch.get_num_threads()
    try:
        assert said in failed(thing, check)[check]
        assert check not in failed(attended, check)
    finally:
        torch.set_num_threads(threads)


@pytest.mark.slow
def test_explainers_declared_slow_pass() -> None:
    assert failed(slow, "time per timestep", slow=True) == {}


@pytest.mark.slow
def test_memory_is_measured_and_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    def hungry(observations: Tensor, policy: Policy) -> Tensor:
        return policy.attention(observations) + 0 * torch.ones(64, 1024, 1024).sum()  # 256 MB

    said = found(hungry, "memory")["memory"].message
    if "does not report" in said:
        pytest.skip(said)
    assert 230 < float(said.split()[0]) < 400
    monkeypatch.setattr("xmarl_bench.checks.explainer_checks.MAX_MEMORY_MB", 100.0)
    assert "explain fewer timesteps at once" in failed(hungry, "memory")["memory"]
    nothing = peak_memory(lambda: None)
    assert nothing is not None
    assert nothing < 5


@pytest.mark.slow
def test_settings_that_pyg_keeps_on_a_class_do_not_fail_the_checks() -> None:
    algorithm = as_explainer(GraphMaskExplainer(1, epochs=1, log=False))
    assert (
        failed(algorithm, "policy untouched", "global random state untouched", "observations untouched") == {}
    )


@pytest.fixture
def own_file(tmp_path: Path) -> Iterator[str]:
    path = tmp_path / "own.py"
    path.write_text(
        "def attended(observations, policy):\n    return policy.attention(observations)\n"
        "def wild(observations, policy):\n    return 2 * policy.attention(observations)\n"
    )
    yield str(path)


@pytest.mark.slow
def test_the_command(
    run_cli: RunCli, make_bundle: MakeBundle, own_file: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delitem(CHECKS, PROCESS)
    bundle = make_bundle()
    passed = run_cli(
        "check", "explainer", f"{own_file}:attended", "--policy", bundle, "--json", "--timesteps", 4
    )
    assert passed.code == 0, passed.err
    record = json.loads(passed.out)
    assert record["passed"] is True
    assert [each["check"] for each in record["findings"]] == list(CHECKS)
    wild = run_cli("check", "explainer", f"{own_file}:wild", "--policy", bundle, "--timesteps", 4)
    assert wild.code == 1
    assert "scale them to [0, 1]" in " ".join(wild.out.split())
    unknown = run_cli("check", "explainer", "atention", "--policy", bundle)
    assert (unknown.code, unknown.out) == (2, "")
    assert "did you mean 'attention'?" in unknown.err
