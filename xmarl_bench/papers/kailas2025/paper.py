"""Task performance as Kailas, Jain and Ravichandar (ICML 2025) report it: mean and standard deviation.

Tables AllTasksPerformance (main), TrainingIterationPerformance and ZeroShotPerformance (appendix). Every cell
is a pair, without and with attention-entropy minimisation. The paper reports no collisions for discovery;
navigation has no walls.
"""

from __future__ import annotations

from typing import NamedTuple

NAVIGATION, PASSAGE, DISCOVERY = "blind_navigation_v0", "blind_passage_v0", "blind_discovery_v0"


class Reported(NamedTuple):
    """A measure over 50 episodes."""

    mean: float
    std: float


Pair = tuple[Reported, Reported]  # without, with the attention-entropy term
Performance = dict[str, Pair]  # by measure


def _pair(*values: float) -> Pair:
    mean, std, regularised_mean, regularised_std = values
    return Reported(mean, std), Reported(regularised_mean, regularised_std)


# By task and team size.
MAIN: dict[tuple[str, int], Performance] = {
    (NAVIGATION, 3): {
        "reward": _pair(2.32, 0.64, 2.29, 0.58),
        "success_rate": _pair(0.99, 0.10, 0.99, 0.10),
        "no_agent_collision": _pair(1.0, 0.0, 1.0, 0.07),
        "makespan": _pair(48.45, 24.90, 48.99, 23.47),
    },
    (NAVIGATION, 4): {
        "reward": _pair(3.05, 0.82, 3.03, 0.70),
        "success_rate": _pair(0.96, 0.21, 0.94, 0.24),
        "no_agent_collision": _pair(0.98, 0.14, 1.0, 0.07),
        "makespan": _pair(61.41, 27.47, 64.18, 30.69),
    },
    (NAVIGATION, 5): {
        "reward": _pair(4.75, 1.10, 4.64, 2.04),
        "success_rate": _pair(0.80, 0.40, 0.90, 0.30),
        "no_agent_collision": _pair(0.94, 0.22, 0.94, 0.24),
        "makespan": _pair(200.92, 116.44, 175.86, 104.04),
    },
    (PASSAGE, 3): {
        "reward": _pair(54.5, 12.7, 55.6, 23.1),
        "success_rate": _pair(1.0, 0.0, 1.0, 0.0),
        "no_agent_collision": _pair(0.30, 0.50, 0.69, 0.50),
        "no_object_collision": _pair(0.0, 0.0, 0.06, 0.2),
        "makespan": _pair(45.445, 21.8, 49.015, 14.4),
    },
    (PASSAGE, 4): {
        "reward": _pair(44.5, 17.3, 32.1, 27.1),
        "success_rate": _pair(0.69, 0.3, 1.0, 0.02),
        "no_agent_collision": _pair(0.58, 0.50, 0.32, 0.50),
        "no_object_collision": _pair(0.0, 0.0, 0.0, 0.0),
        "makespan": _pair(119.505, 42.4, 119.675, 35.3),
    },
    (PASSAGE, 5): {
        "reward": _pair(37.9, 24.3, 33.2, 21.7),
        "success_rate": _pair(0.91, 0.24, 0.99, 0.08),
        "no_agent_collision": _pair(0.11, 0.31, 0.22, 0.41),
        "no_object_collision": _pair(0.0, 0.0, 0.0, 0.0),
        "makespan": _pair(84.885, 37.7, 100.2, 33.26),
    },
    (DISCOVERY, 3): {
        "reward": _pair(0.92, 0.27, 0.88, 0.35),
        "success_rate": _pair(0.92, 0.27, 0.87, 0.34),
        "makespan": _pair(112.38, 135.85, 145.19, 150.28),
    },
    (DISCOVERY, 4): {
        "reward": _pair(0.99, 0.12, 0.96, 0.23),
        "success_rate": _pair(0.99, 0.12, 0.95, 0.22),
        "makespan": _pair(95.16, 103.32, 134.79, 120.83),
    },
    (DISCOVERY, 5): {
        "reward": _pair(0.92, 0.29, 0.95, 0.23),
        "success_rate": _pair(0.92, 0.28, 0.95, 0.23),
        "makespan": _pair(113.25, 133.33, 108.95, 116.55),
    },
}

# Navigation, three agents, by percent of training.
TRAINING: dict[int, Performance] = {
    20: {
        "reward": _pair(2.34, 0.69, 2.11, 0.77),
        "success_rate": _pair(0.22, 0.41, 0.75, 0.43),
        "no_agent_collision": _pair(1.0, 0.0, 1.0, 0.0),
        "makespan": _pair(128.3, 40.87, 72.37, 47.74),
    },
    50: {
        "reward": _pair(2.37, 0.65, 2.37, 0.60),
        "success_rate": _pair(0.97, 0.15, 0.95, 0.21),
        "no_agent_collision": _pair(1.0, 0.0, 1.0, 0.0),
        "makespan": _pair(50.8, 28.40, 58.45, 27.94),
    },
    80: {
        "reward": _pair(2.20, 0.81, 2.39, 0.53),
        "success_rate": _pair(0.97, 0.15, 0.97, 0.15),
        "no_agent_collision": _pair(0.97, 0.15, 1.0, 0.0),
        "makespan": _pair(47.5, 25.28, 55.6, 28.05),
    },
}

# Navigation, by agents in training and in the test.
ZERO_SHOT: dict[tuple[int, int], Performance] = {
    (3, 4): {
        "reward": _pair(2.68, 1.28, 2.79, 0.69),
        "success_rate": _pair(1.0, 0.0, 0.93, 0.26),
        "no_agent_collision": _pair(0.93, 0.26, 0.93, 0.26),
        "makespan": _pair(61.57, 25.16, 60.82, 33.83),
    },
    (3, 5): {
        "reward": _pair(4.74, 1.21, 5.02, 0.99),
        "success_rate": _pair(0.82, 0.37, 0.95, 0.21),
        "no_agent_collision": _pair(0.92, 0.26, 0.97, 0.15),
        "makespan": _pair(154.57, 121.44, 120.5, 75.15),
    },
    (3, 6): {
        "reward": _pair(3.98, 1.26, 4.08, 1.68),
        "success_rate": _pair(0.9, 0.29, 0.88, 0.33),
        "no_agent_collision": _pair(0.67, 0.47, 0.75, 0.43),
        "makespan": _pair(116.6, 103.4, 129.4, 110.33),
    },
    (4, 5): {
        "reward": _pair(5.08, 0.93, 5.03, 0.70),
        "success_rate": _pair(0.92, 0.26, 1.0, 0.0),
        "no_agent_collision": _pair(0.92, 0.26, 0.98, 0.15),
        "makespan": _pair(125.17, 88.26, 103.87, 58.46),
    },
    (4, 6): {
        "reward": _pair(6.55, 1.52, 6.33, 1.62),
        "success_rate": _pair(0.87, 0.33, 0.95, 0.21),
        "no_agent_collision": _pair(0.8, 0.40, 0.88, 0.33),
        "makespan": _pair(149.82, 102.37, 135.32, 82.67),
    },
    (4, 7): {
        "reward": _pair(5.14, 0.95, 5.12, 0.99),
        "success_rate": _pair(0.80, 0.40, 0.80, 0.40),
        "no_agent_collision": _pair(0.85, 0.35, 0.75, 0.43),
        "makespan": _pair(158.62, 125.71, 174.47, 130.42),
    },
    (5, 6): {
        "reward": _pair(6.03, 2.00, 6.41, 1.61),
        "success_rate": _pair(0.52, 0.49, 0.72, 0.44),
        "no_agent_collision": _pair(0.87, 0.33, 0.95, 0.21),
        "makespan": _pair(282.7, 123.71, 248.17, 114.98),
    },
    (5, 7): {
        "reward": _pair(7.33, 3.18, 8.70, 2.30),
        "success_rate": _pair(0.42, 0.49, 0.52, 0.49),
        "no_agent_collision": _pair(0.6, 0.48, 0.85, 0.35),
        "makespan": _pair(333.72, 90.45, 296.85, 108.79),
    },
    (5, 8): {
        "reward": _pair(5.04, 4.22, 5.82, 3.48),
        "success_rate": _pair(0.2, 0.40, 0.45, 0.49),
        "no_agent_collision": _pair(0.52, 0.49, 0.72, 0.44),
        "makespan": _pair(362.7, 80.47, 341.57, 80.20),
    },
}
