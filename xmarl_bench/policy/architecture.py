"""The architecture of a policy as data: enough to rebuild the network, and no code.

Widths, layers and heads are bounded here. xmarl_bench.policy.shapes checks that a record's weights fit into
memory before anything is built.
"""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from xmarl_bench.policy.graph import CompleteGraph, Graph

Width = Annotated[int, Field(ge=1, le=2048)]
Widths = Annotated[tuple[Width, ...], Field(max_length=8)]
Entries = Annotated[tuple[Annotated[int, Field(ge=0, lt=4096)], ...], Field(max_length=8)]
Activation = Literal["tanh", "relu", "elu", "leaky_relu", "silu", "identity"]
Convolution = Literal["GATConv", "GATv2Conv", "TransformerConv"]
DistributionKind = Literal["tanh_normal", "normal", "deterministic", "categorical"]
# How a decoder's output becomes a scale; both map 0 to 1.
# softplus: softplus(raw + log(e - 1)), at least 1e-4. torchrl: TorchRL's and BenchMARL's default
# "biased_softplus_1.0", softplus(raw + log(e^0.99 - 1)) + 0.01.
ScaleKind = Literal["softplus", "torchrl"]
MAX_LAYER_WIDTH = 4096  # of all heads together


def raw_width(kind: DistributionKind, action_dim: int) -> int:
    """Number of decoder outputs per agent. action_dim: number of action entries, or of discrete actions."""
    return 2 * action_dim if kind in ("tanh_normal", "normal") else action_dim


class _Record(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


class Memory(_Record):
    """A recurrent cell shared by all agents, each with its own memory, and the cell's place in the network.

    A memory is 0 before the first timestep. torch's `GRUCell` and `LSTMCell`, a single layer.
    """

    cell: Literal["gru", "lstm"]
    width: Width  # of its output
    # Number of message-passing layers before it. 0: its input is the encoder's output, so messages depend on
    # the sender's memory. After the last layer: its input is that layer's output, and the decoder follows.
    after: Annotated[int, Field(ge=0, le=8)] = 0

    @property
    def size(self) -> int:
        """H, numbers to remember: the output of a GRU; output and cell state of an LSTM, in this order."""
        return self.width if self.cell == "gru" else 2 * self.width


# Not written if None, so that records without this field keep their hash.
OptionalMemory = Annotated[Memory | None, Field(exclude_if=lambda memory: memory is None)]


class _Network(_Record):
    memory: OptionalMemory = None

    @property
    def memory_dim(self) -> int:
        """H, numbers that each agent remembers from one timestep to the next."""
        return 0 if self.memory is None else self.memory.size

    def _check_place(self, n_layers: int) -> None:
        if self.memory is not None and self.memory.after > n_layers:
            raise ValueError(
                f"the memory is after layer {self.memory.after}, but there are {n_layers}: give one from "
                f"0 (before the first) to {n_layers}"
            )


class Architecture(_Network):
    """MLP encoder, one GATv2 layer with one head, MLP decoder to a TanhNormal's (loc, scale), or to logits.

    An empty `encoder` is the identity. `action_dim` of a categorical is the number of its actions. The graph
    is complete. Source: Kailas et al. (ICML 2025), section "Tasks"; their layer has no `residual`.
    """

    kind: Literal["mlp-gatv2-mlp"] = "mlp-gatv2-mlp"
    obs_dim: Annotated[int, Field(ge=1, le=4096)]
    action_dim: Annotated[int, Field(ge=1, le=64)] = 2
    encoder: Widths
    encoder_activation: Activation
    gat_width: Width
    gat_activation: Activation
    # See GraphLayer. Not written if False, so that records without this field keep their hash.
    residual: Annotated[bool, Field(exclude_if=lambda residual: not residual)] = False
    decoder: Widths
    decoder_activation: Activation
    distribution: Literal["tanh_normal", "categorical"] = "tanh_normal"
    graph: ClassVar[Graph] = CompleteGraph()

    @model_validator(mode="after")
    def _placed(self) -> Architecture:
        self._check_place(1)
        return self


class EdgeFeatures(_Record):
    """What a layer gets with an edge j -> i, as in BenchMARL's GNN: the position of j minus that of i, their
    distance, the velocity of j minus that of i. Those without entries are left out.
    """

    position: Entries = ()  # the entries of an observation that hold it
    velocity: Entries = ()
    # Of an edge i -> i. zero: as of any edge. mean: the mean over the receiver's edges from others, as of
    # loops that torch_geometric's layers add themselves.
    own: Literal["zero", "mean"] = "zero"

    @property
    def width(self) -> int:
        return len(self.position) + bool(self.position) + len(self.velocity)

    @model_validator(mode="after")
    def _present(self) -> EdgeFeatures:
        if self.width == 0:
            raise ValueError("edge features need entries of the position or the velocity")
        return self


class GraphLayer(_Record):
    """One attention layer of torch_geometric and the activation after it."""

    conv: Convolution
    width: Width  # of each head
    heads: Annotated[int, Field(ge=1, le=16)] = 1
    concat: bool = True  # True: heads are concatenated; False: averaged
    # Adds the layer's input through a linear map: `residual` of GATConv and GATv2Conv, `root_weight` of
    # TransformerConv. It is not a message, so masks do not scale it.
    residual: bool = False
    # They change attention coefficients; of TransformerConv, messages too.
    edges: Annotated[EdgeFeatures | None, Field(exclude_if=lambda edges: edges is None)] = None
    activation: Activation

    @property
    def out_width(self) -> int:
        return self.width * self.heads if self.concat else self.width

    @model_validator(mode="after")
    def _bounded(self) -> GraphLayer:
        if self.width * self.heads > MAX_LAYER_WIDTH:
            raise ValueError(
                f"{self.heads} heads of width {self.width} are wider than {MAX_LAYER_WIDTH} together"
            )
        return self


class LayeredArchitecture(_Network):
    """MLP encoder, one or more attention layers on any `Graph`, MLP decoder, any distribution.

    An empty `encoder` is the identity. `action_dim` of a categorical is the number of its actions.
    """

    kind: Literal["mlp-layers-mlp"] = "mlp-layers-mlp"
    obs_dim: Annotated[int, Field(ge=1, le=4096)]
    action_dim: Annotated[int, Field(ge=1, le=64)] = 2
    encoder: Widths = ()
    encoder_activation: Activation = "tanh"
    layers: Annotated[tuple[GraphLayer, ...], Field(min_length=1, max_length=8)]
    decoder: Widths = ()
    decoder_activation: Activation = "tanh"
    distribution: DistributionKind = "tanh_normal"
    scale: ScaleKind = "softplus"
    graph: Graph = CompleteGraph()

    def as_one_layer(self) -> Architecture | None:
        """The same network as a record for the fast path; None if the fast path does not support it."""
        layer = self.layers[0]
        fits = (
            len(self.layers) == 1
            and (layer.conv, layer.heads, layer.edges) == ("GATv2Conv", 1, None)
            and self.distribution in ("tanh_normal", "categorical")
            and self.scale == "softplus"
            and self.graph == CompleteGraph()
        )
        if not fits:
            return None
        same = self.model_dump(include=Architecture.model_fields.keys() - {"kind"})
        of_layer = {"gat_width": layer.width, "gat_activation": layer.activation, "residual": layer.residual}
        return Architecture.model_validate({**same, **of_layer})

    @model_validator(mode="after")
    def _placed(self) -> LayeredArchitecture:
        self._check_place(len(self.layers))
        for edges in (layer.edges for layer in self.layers):
            last = -1 if edges is None else max(*edges.position, *edges.velocity, -1)
            if last >= self.obs_dim:
                raise ValueError(
                    f"edge features need entry {last} of an observation of {self.obs_dim} entries"
                )
        return self


class CodeArchitecture(_Record):
    """A network that only its author's code can build: needs `--trust-code`, and is never part of a bundle.

    Reproducing an entry with this record requires running the code at `entry_point`.
    """

    kind: Literal["code"] = "code"
    obs_dim: Annotated[int, Field(ge=1, le=4096)]
    action_dim: Annotated[int, Field(ge=1, le=64)] = 2
    entry_point: str  # module:factory
    package: str | None  # the installed distribution that holds it
    version: str | None
    code_sha256: str | None  # of the file that defines the factory
    distribution: DistributionKind
    graph: Graph


AnyArchitecture = Annotated[
    Architecture | LayeredArchitecture | CodeArchitecture, Field(discriminator="kind")
]
BundledArchitecture = Annotated[Architecture | LayeredArchitecture, Field(discriminator="kind")]
