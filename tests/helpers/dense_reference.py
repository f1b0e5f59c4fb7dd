"""The policy written out edge by edge in float64 from its formulas, without code of the benchmark.

GATv2 (Brody et al., ICLR 2022): e_ij = a . LeakyReLU(W_l x_j + W_r x_i), alpha_i = softmax_j e_ij;
h_i = sum_j m_ij alpha_ij W_l x_j + R x_i + b, where R is 0 without a residual. Under an absence model other
than zero, sum_j (1 - m_ij) alpha_ij v_j of stand-ins v is added, or m_ij alpha_ij are divided by their sum.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from xmarl_bench.policy import GraphPolicy

Floats = NDArray[np.float64]
ACTIVATION: dict[str, Callable[[Floats], Floats]] = {"tanh": np.tanh, "relu": lambda x: np.maximum(x, 0.0)}


def reference_messages(policy: GraphPolicy, observation: Floats) -> Floats:
    """(N, D) -> (N, W): W_l x_j of each sender."""
    return _linear(_weights(policy), "gat.lin_l", _encoded(policy, observation))


def reference_distribution(
    policy: GraphPolicy,
    observation: Floats,
    mask: Floats,
    said: Floats | None = None,
    *,
    stand_in: Floats | None = None,
    renormalised: bool = False,
) -> tuple[Floats, Floats]:
    """(N, D) observations of one timestep, (N, N) mask -> loc (N, A), scale (N, A).

    said: (N, D) other observations, of which the messages are that receivers hear; they attend as they did.
    stand_in: (N, W), heard in place of what the mask takes away.
    """
    weights, architecture = _weights(policy), policy.architecture
    n_agents = len(observation)
    x, message = _encoded(policy, observation), reference_messages(policy, observation)
    heard = message if said is None else reference_messages(policy, said)
    receiver = _linear(weights, "gat.lin_r", x)
    a = weights["gat.att"].reshape(-1)
    hidden = np.zeros((n_agents, architecture.gat_width))
    for i in range(n_agents):
        scores = np.zeros(n_agents)
        for j in range(n_agents):
            pair = receiver[i] + message[j]
            scores[j] = a @ np.where(pair > 0, pair, 0.2 * pair)
        alpha = np.exp(scores - scores.max())
        alpha /= alpha.sum()
        for j in range(n_agents):
            kept = mask[i, j] / sum(mask[i] * alpha) if renormalised else mask[i, j]
            hidden[i] += kept * alpha[j] * heard[j]
            if stand_in is not None:
                hidden[i] += (1.0 - mask[i, j]) * alpha[j] * stand_in[j]
    if architecture.residual:
        hidden += x @ weights["gat.res.weight"].T
    hidden = ACTIVATION[architecture.gat_activation](hidden + weights["gat.bias"])
    for layer in range(len(architecture.decoder)):
        hidden = _linear(weights, f"decoder.{2 * layer}", hidden)
        hidden = ACTIVATION[architecture.decoder_activation](hidden)
    out = _linear(weights, f"decoder.{2 * len(architecture.decoder)}", hidden)
    loc, raw_scale = out[:, : architecture.action_dim], out[:, architecture.action_dim :]
    return loc, np.maximum(np.log1p(np.exp(raw_scale + np.log(math.e - 1.0))), 1e-4)


def _weights(policy: GraphPolicy) -> dict[str, Floats]:
    return {key: tensor.double().numpy() for key, tensor in policy.state_dict().items()}


def _encoded(policy: GraphPolicy, x: Floats) -> Floats:
    weights, architecture = _weights(policy), policy.architecture
    for layer in range(len(architecture.encoder)):
        x = ACTIVATION[architecture.encoder_activation](_linear(weights, f"encoder.{2 * layer}", x))
    return x


def _linear(weights: dict[str, Floats], name: str, x: Floats) -> Floats:
    return np.asarray(x @ weights[f"{name}.weight"].T + weights[f"{name}.bias"])
