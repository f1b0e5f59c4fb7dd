"""A policy on disk: `policy.safetensors` (weights) and `policy.json` (its card). Loading executes nothing."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Annotated, Any

import torch
from pydantic import BaseModel, ConfigDict, Field, ValidationError
from safetensors import SafetensorError
from safetensors.torch import load, save

from xmarl_bench.errors import InputError
from xmarl_bench.files import write_atomically
from xmarl_bench.policy.architecture import Architecture
from xmarl_bench.policy.network import GraphPolicy

WEIGHTS, CARD = "policy.safetensors", "policy.json"
MAX_BYTES = 64 * 1024 * 1024


class PolicyCard(BaseModel):
    """What one should know of a policy, and what rebuilds it."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9._-]{0,99}$")]
    task: str
    n_agents: Annotated[int, Field(ge=1, le=1024)]
    attention_entropy: float = Field(description="weight lambda of the attention-entropy term in training")
    training_seed: int | None = None
    architecture: Architecture
    weights_sha256: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
    training: dict[str, Any] = Field(default_factory=dict, description="how it was trained, as recorded then")
    performance: dict[str, Any] = Field(default_factory=dict, description="task metrics, as measured then")


def save_policy(folder: Path, policy: GraphPolicy, **card: Any) -> PolicyCard:
    """Write weights and card into `folder` (made if missing), each file whole or not at all."""
    weights = save({key: tensor.contiguous() for key, tensor in policy.state_dict().items()})
    record = PolicyCard(
        architecture=policy.architecture, weights_sha256=hashlib.sha256(weights).hexdigest(), **card
    )
    folder.mkdir(parents=True, exist_ok=True)
    write_atomically(folder / WEIGHTS, weights)
    write_atomically(folder / CARD, (record.model_dump_json(indent=2) + "\n").encode())
    return record


def load_card(folder: Path) -> PolicyCard:
    """Read and validate `policy.json` alone. Raises InputError."""
    try:
        return PolicyCard.model_validate_json(_read(folder / CARD))
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"]) or "the whole file"
        raise InputError(f"{folder / CARD} is not a policy card: {first['msg']} at {where}.") from None


def load_policy(folder: Path) -> tuple[GraphPolicy, PolicyCard]:
    """Rebuild the network of a bundle, in evaluation mode.

    Raises InputError where a file is missing, truncated, of another architecture or not the one the card
    names, or where a weight is not finite.
    """
    card = load_card(folder)
    data = _read(folder / WEIGHTS)
    try:
        weights = load(data)
    except SafetensorError as error:
        raise InputError(
            f"{folder / WEIGHTS} cannot be read as safetensors ({error}): save it again."
        ) from None
    policy = GraphPolicy(card.architecture)
    expected = {key: tuple(tensor.shape) for key, tensor in policy.state_dict().items()}
    received = {key: tuple(tensor.shape) for key, tensor in weights.items()}
    if expected != received:
        wrong = sorted(
            key for key in expected.keys() | received.keys() if expected.get(key) != received.get(key)
        )
        raise InputError(
            f"{folder / WEIGHTS} does not fit the architecture in {CARD}: tensor {wrong[0]!r} has shape "
            f"{received.get(wrong[0])}, expected {expected.get(wrong[0])}."
        )
    if not all(bool(torch.isfinite(tensor).all()) for tensor in weights.values()):
        raise InputError(
            f"{folder / WEIGHTS} holds weights that are NaN or infinite: train or save it again."
        )
    digest = hashlib.sha256(data).hexdigest()
    if digest != card.weights_sha256:
        raise InputError(
            f"{folder / WEIGHTS} has sha256 {digest[:12]}..., its card says {card.weights_sha256[:12]}...: "
            f"the two files do not belong together."
        )
    policy.load_state_dict(weights)
    return policy.eval(), card


def _read(path: Path) -> bytes:
    try:
        if path.stat().st_size > MAX_BYTES:
            raise InputError(f"{path} is larger than {MAX_BYTES} bytes: that is no policy of this format.")
        return path.read_bytes()
    except OSError as error:
        raise InputError(f"{path} cannot be read ({error.strerror}): give the folder of a policy.") from None
