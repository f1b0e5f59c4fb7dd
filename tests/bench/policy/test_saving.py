"""Policies are saved as torch's users have them, compiled, wrapped or in half precision, and load again."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import cast

import pytest
import torch
from torch import nn
from torch.nn.utils.parametrizations import weight_norm
from torch.optim.swa_utils import AveragedModel

from tests.bench.policy.test_layers import GAT2, random_policy, record
from tests.helpers.policies import small_policy
from xmarl_bench.errors import InputError
from xmarl_bench.policy import GraphPolicy, build_policy, load_policy, save_policy
from xmarl_bench.policy.build import LayeredPolicy, weights_of

CARD = {"name": "saved", "task": "blind_navigation_v0", "n_agents": 3, "attention_entropy": 0.0}
Made = GraphPolicy | LayeredPolicy


def compiled(policy: Made) -> nn.Module:
    return cast(nn.Module, torch.compile(policy, backend="eager"))


def compiled_part(policy: Made) -> nn.Module:
    if isinstance(policy, GraphPolicy):
        policy.decoder = torch.compile(policy.decoder, backend="eager")  # type: ignore[assignment]
    else:
        policy.network = torch.compile(policy.network, backend="eager")  # type: ignore[assignment]
    return policy


WRAPPERS: dict[str, Callable[[Made], nn.Module]] = {
    "compiled": compiled,
    "compiled part": compiled_part,
    "DataParallel": nn.DataParallel,
    "averaged": AveragedModel,
    "twice": lambda policy: nn.DataParallel(compiled(policy)),
    "half": lambda policy: policy.half(),
    "bfloat16": lambda policy: policy.bfloat16(),
    "double": lambda policy: policy.double(),
    "frozen": lambda policy: policy.requires_grad_(False),
}


@pytest.mark.slow
@pytest.mark.parametrize("wrap", WRAPPERS.values(), ids=WRAPPERS)
@pytest.mark.parametrize("layered", [False, True])
def test_what_is_saved_loads(layered: bool, wrap: Callable[[Made], nn.Module], tmp_path: Path) -> None:
    policy: Made = random_policy(record(GAT2)) if layered else small_policy(6, 2)
    before = {name: tensor.clone() for name, tensor in weights_of(policy).items()}
    wrapped = wrap(policy)
    save_policy(tmp_path / "saved", wrapped, **CARD)
    loaded, card = load_policy(tmp_path / "saved")
    assert card.architecture == policy.architecture
    after = weights_of(loaded)
    assert after.keys() == before.keys()
    dtype = next(wrapped.parameters()).dtype
    for name, tensor in before.items():
        assert torch.equal(after[name], tensor.to(dtype).float())


def with_weight_norm(policy: Made) -> nn.Module:
    assert isinstance(policy, GraphPolicy)
    weight_norm(policy.decoder[0])
    return policy


def with_nan(policy: Made) -> nn.Module:
    next(policy.parameters()).data.fill_(torch.nan)
    return policy


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda policy: nn.Sequential(policy), "networks of build_policy, got Sequential"),
        (lambda policy: policy.to("meta"), "does not hold finite"),
        (with_nan, "does not hold finite"),
        (with_weight_norm, "do not fit the architecture"),
    ],
)
def test_other_networks_are_refused(change: Callable[[Made], nn.Module], said: str, tmp_path: Path) -> None:
    policy = change(build_policy(small_policy(6, 2).architecture))
    with pytest.raises(InputError, match=said):
        save_policy(tmp_path / "saved", policy, **CARD)
    assert not (tmp_path / "saved").exists()


@pytest.mark.parametrize(
    ("field", "said"),
    [
        ({"name": "my policy"}, "name is invalid: String should match"),
        ({"n_agents": 0}, "n_agents is invalid"),
        ({"training_seed": 1.5}, "training_seed is invalid"),
        ({"lambda": 0.1}, "lambda is invalid: Extra inputs"),
    ],
)
def test_an_invalid_card_is_not_saved(field: dict[str, object], said: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=said):
        save_policy(tmp_path / "saved", small_policy(6, 2), **CARD | field)
    assert not (tmp_path / "saved").exists()
