"""A policy on disk: `policy.safetensors` (weights) and `policy.json` (its card). Loading executes nothing.

A bundle is a folder with the two files, or a zip of them. It may come from anyone: see
xmarl_bench.policy.untrusted for what is refused before anything is built.
"""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Any

import torch
from pydantic import BaseModel, ConfigDict, Field, ValidationError
from safetensors import SafetensorError
from safetensors.torch import load, save

from xmarl_bench.errors import InputError
from xmarl_bench.field_types import Agents, Name, Sha256
from xmarl_bench.files import write_atomically
from xmarl_bench.policy.architecture import AnyArchitecture, CodeArchitecture
from xmarl_bench.policy.build import LayeredPolicy, build_policy, weight_shapes, weights_of
from xmarl_bench.policy.network import GraphPolicy
from xmarl_bench.policy.untrusted import CARD, MAX_BYTES, WEIGHTS, check_weights, read_member
from xmarl_bench.strict_json import first_error, parse_json, shown


class PolicyCard(BaseModel):
    """What one should know of a policy, and what rebuilds it."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    name: Name
    task: str
    n_agents: Agents
    attention_entropy: float = Field(description="weight lambda of the attention-entropy term in training")
    training_seed: int | None = None
    architecture: AnyArchitecture
    weights_sha256: Sha256
    training: dict[str, Any] = Field(default_factory=dict, description="how it was trained, as recorded then")
    performance: dict[str, Any] = Field(default_factory=dict, description="task metrics, as measured then")


def save_policy(folder: Path, policy: GraphPolicy | LayeredPolicy, **card: Any) -> PolicyCard:
    """Write weights and card into `folder` (made if missing), each file whole or not at all."""
    weights = save({key: tensor.contiguous() for key, tensor in weights_of(policy).items()})
    record = PolicyCard(
        architecture=policy.architecture, weights_sha256=hashlib.sha256(weights).hexdigest(), **card
    )
    folder.mkdir(parents=True, exist_ok=True)
    write_atomically(folder / WEIGHTS, weights)
    write_atomically(folder / CARD, (record.model_dump_json(indent=2) + "\n").encode())
    return record


def load_card(bundle: Path) -> PolicyCard:
    """Read and validate `policy.json` alone. Raises InputError."""
    data = read_member(bundle, CARD)
    try:
        parse_json(data, max_bytes=MAX_BYTES[CARD])
        card = PolicyCard.model_validate_json(data)
    except ValidationError as error:
        said, where = first_error(error)
        said, where = shown(said, 200).strip("'\""), shown(where or "the whole file")
        raise InputError(f"{bundle / CARD} is not a policy card: {said} at {where}.") from None
    except ValueError as error:
        raise InputError(f"{bundle / CARD} is not a policy card: it {error}.") from None
    if isinstance(card.architecture, CodeArchitecture):
        raise InputError(
            f"{bundle / CARD} is not a policy card: its architecture is code, and a bundle holds none: give "
            f"the code itself, as module:factory with --trust-code."
        )
    return card


def load_policy(bundle: Path) -> tuple[GraphPolicy | LayeredPolicy, PolicyCard]:
    """Rebuild the network of a bundle, in evaluation mode.

    Raises InputError where a file is missing, truncated, of another architecture or not the one the card
    names, or where a weight is not finite.
    """
    card = load_card(bundle)
    assert not isinstance(card.architecture, CodeArchitecture)
    where = str(bundle / WEIGHTS)
    expected = weight_shapes(card.architecture)
    data = read_member(bundle, WEIGHTS)
    check_weights(data, expected, where)
    try:
        weights = load(data)
    except SafetensorError as error:
        raise InputError(f"{where} cannot be read as safetensors ({shown(error)}): save it again.") from None
    if not all(bool(torch.isfinite(tensor).all()) for tensor in weights.values()):
        raise InputError(f"{where} holds weights that are NaN or infinite: train or save it again.")
    digest = hashlib.sha256(data).hexdigest()
    if digest != card.weights_sha256:
        raise InputError(
            f"{where} has sha256 {digest[:12]}..., its card says {card.weights_sha256[:12]}...: "
            f"the two files do not belong together."
        )
    return build_policy(card.architecture, weights), card
