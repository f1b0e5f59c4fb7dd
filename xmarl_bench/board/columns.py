"""What the board shows, in which order, and what it takes to be ranked."""

from __future__ import annotations

ORDER = {
    "by": "comm_budgeted_fidelity",
    "direction": "descending",
    "controls": "shown in place, not ranked",
    "note": "Communication-only budgeted fidelity: 0 is a random ranking of the messages, 1 the best one. "
    "FidDelta alone can be gamed: the mask of ones, a control, attains most of it.",
}
# A team that fails has nothing worth explaining, and one that hardly listens makes every explanation of its
# messages trivially faithful. The dependence is 1 % of the range of an action, [-1, 1].
GATE = {"success_rate": 0.5, "communication_dependence": 0.02}
# Metric -> heading; an arrow says which way is better.
COLUMNS = {
    "comm_budgeted_fidelity": "comm. budgeted fidelity \u2191",
    "budgeted_fidelity": "budgeted fidelity \u2191",
    "fid_plus": "Fid+ \u2191",
    "fid_minus": "Fid\u2212 \u2193",
    "fid_delta": "FidDelta \u2191",
    "gef": "GEF \u2193",
    "median_kl": "median KL \u2193",
    "mask_mass": "mask mass",
    "comm_fid_delta": "comm. FidDelta \u2191",
    "comm_gef": "comm. GEF \u2193",
    "renorm_budgeted_fidelity": "renorm. budgeted fidelity \u2191",
    "success_on_explanation": "success on explanation \u2191",
    "success_on_complement": "success on complement \u2193",
    "no_agent_collision_on_explanation": "collision-free on explanation \u2191",
    "no_agent_collision_on_complement": "collision-free on complement \u2193",
    "seed_stability": "seed stability \u2191",
    "weight_randomisation": "shuffled weights \u2193",
}
PAPER = ("fid_plus", "fid_minus", "fid_delta", "gef")  # beside the order in every table
UNSHOWN = ("reward_on_explanation", "reward_on_complement", "behavioural_fidelity", "topk_fid_delta",
           "comm_fid_plus", "comm_fid_minus", "comm_topk_fid_delta", "renorm_topk_fid_delta")  # fmt: skip
POLICY_METRICS = (
    "success_rate", "no_agent_collision", "no_object_collision", "makespan", "reward",
    "communication_dependence", "attention_entropy", "attention_distance",
)  # fmt: skip
