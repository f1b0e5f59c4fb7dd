"""What the numbers of an entry mean. Scores depend on every word here: a change is a new protocol id.

Formulae and reasons are in docs/metrics.md.
"""

from __future__ import annotations

from typing import Final

PROTOCOL: Final = "xmarl-2"
# What is checked of an explainer's sanity: the first episodes of a run, timesteps evenly spaced in each.
SANITY_EPISODES: Final = 5
SANITY_TIMESTEPS: Final = 20

DEFINITIONS: dict[str, str] = {
    "F(m)": "action tanh(loc) in [-1, 1] with the message on edge j -> i scaled by m[i, j] after the "
    "softmax, nothing renormalised",
    "fid_minus": "mean over agents of d_i(m), d_i(m) = mean over action entries of |F_i(1) - F_i(m)|",
    "fid_plus": "mean over agents of d_i(1 - m)",
    "fid_delta": "fid_plus - fid_minus",
    "gef": "mean over agents of 1 - exp(-KL(F_i(1) || F_i(m))), diagonal Normals under the tanh, summed over "
    "action entries",
    "median_kl": "median of that KL over the agents and timesteps of an episode",
    "mask_mass": "mean of the mask over all edges, the agents' own among them",
    "topk_fid_delta": "FidDelta@k, mean over k = 1 .. N - 1: fid_delta of the binary mask that keeps the k "
    "highest edges of each row, ties broken at random",
    "budgeted_fidelity": "(FidDelta@k - random@k) / (oracle@k - random@k), mean over k = 1 .. N - 1; "
    "random@k is the mean over all k-subsets of a row and oracle@k the maximum; each averaged over agents "
    "and timesteps of the episode before dividing; a k whose denominator is under 0.001 is left out, null "
    "where none is left",
    "comm_*": "the same with every agent's own edge kept in subgraph and complement alike, so that messages "
    "between agents are ranked alone, k = 1 .. N - 2",
    "renorm_*": "the same where dropped edges leave the softmax: the coefficients kept sum to 1",
    "seed_stability": "rank correlation of the masks of 3 seeds, mean over pairs; null where the explainer "
    "is not stochastic",
    "weight_randomisation": "rank correlation of the mask with that of the policy whose parameter tensors "
    "have their entries shuffled",
    "rank correlation": "Spearman's, of senders within each row, pooled over rows and timesteps; on the "
    "first 5 episodes and at most 20 timesteps of each",
    "success_on_explanation": "success_rate where the team communicates only along the k = floor((N - 1) / "
    "2) highest messages of each row of the explanation of its own states; own edges are kept",
    "success_on_complement": "the same, communicating only along the other messages",
    "reward_on_explanation": "reward of the team on the explanation",
    "reward_on_complement": "reward of the team on the complement",
    "no_agent_collision_on_explanation": "no_agent_collision of the team on the explanation",
    "no_agent_collision_on_complement": "no_agent_collision of the team on the complement",
    "behavioural_fidelity": "success_on_explanation - success_on_complement",
    "communication_dependence": "mean over agents of d_i(identity): what removing all messages between "
    "agents changes",
    "attention_entropy": "mean over agents of the entropy of their attention, in nats",
    "attention_distance": "D(alpha) = sum over edges of |2 alpha - 1|",
    "reward": "mean over agents of the return",
    "success_rate": "fraction of agents at goal when the episode ends; discovery: 1 if found",
    "no_agent_collision": "1 if no two agents collided in the episode",
    "no_object_collision": "1 if nobody touched a wall; null where there are no walls",
    "makespan": "steps until done, max_cycles if never",
    "controls": "other masks on the same policy and states: all-ones, zeros, random (uniform), bernoulli "
    "(0.5), self (own edges), inverted (1 - m), oracle (the best binary mask for fid_delta), soft-oracle "
    "(projected ascent from it)",
    "aggregation": "mean over timesteps within an episode, then mean over episodes; percentile bootstrap "
    "interval (95 %) over episodes; what is not a number is left out and counted in n_nan",
    "timesteps": "null: all T of an episode; K: at most K, number floor((2 k + 1) T / (2 K)), k = 0 .. K - 1",
    "seeds": "environment seed of each episode: 10^12 + seed * 10^6 + k",
}
