"""The architecture of a policy as data: enough to rebuild the network, nothing that could run."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

Width = Annotated[int, Field(ge=1, le=2048)]
Widths = Annotated[tuple[Width, ...], Field(max_length=8)]
Activation = Literal["tanh", "relu"]


class Architecture(BaseModel):
    """MLP encoder, one GATv2 layer with one head, MLP decoder to the (loc, scale) of a TanhNormal.

    An empty `encoder` is the identity. Source: Kailas et al. (ICML 2025), section "Tasks".
    """

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

    kind: Literal["mlp-gatv2-mlp"] = "mlp-gatv2-mlp"
    obs_dim: Annotated[int, Field(ge=1, le=4096)]
    action_dim: Annotated[int, Field(ge=1, le=64)] = 2
    encoder: Widths
    encoder_activation: Activation
    gat_width: Width
    gat_activation: Activation
    decoder: Widths
    decoder_activation: Activation
    distribution: Literal["tanh_normal"] = "tanh_normal"
