"""One step of a single team that touches nothing. Python's numbers: arrays of a few elements take longer."""

from __future__ import annotations

from xmarl_envs.free_flight import DURATION, MARGIN, VELOCITY_KEPT
from xmarl_envs.slotted_space import CONTACT_CHECKS, PUSH
from xmarl_envs.task import Floats, Task

_PUSH, _DURATION, _KEPT = float(PUSH), float(DURATION), float(VELOCITY_KEPT)


def fly_alone(
    task: Task, position: Floats, velocity: Floats, force: Floats, walls: Floats
) -> tuple[bool, bool]:
    """Advance a team (N, 2) between walls (W, 2), in place, with the bits of `fly`, if nothing touches.

    Returns `touches` and `close` of `xmarl_envs.free_flight.touching`. Nothing moves if the first is True.
    """
    starts, speeds, fastest = position.ravel().tolist(), [], 0.0
    leaps, hops, turns, ends = [], [], [], []  # of both substeps: by a leap each move, then by a hop
    for x, v, f in zip(starts, velocity.ravel().tolist(), force.ravel().tolist(), strict=True):
        push = f * _PUSH * _DURATION
        leap = v * _DURATION
        v = v * _KEPT + push
        hop = v * _DURATION
        turn = x + leap + leap + leap  # CONTACT_CHECKS times
        leaps.append(leap)
        hops.append(hop)
        turns.append(turn)
        ends.append(turn + hop + hop + hop)
        speeds.append(v * _KEPT + push)
        fastest = max(fastest, abs(leap) + abs(hop))
    contact = 2 * task.radius + MARGIN
    reach = contact + max(task.collision_gap, 0.0) + 2 * CONTACT_CHECKS * fastest
    close = False
    for i in range(2, len(ends), 2):
        for j in range(0, i, 2):
            if abs(ends[i] - ends[j]) < reach and abs(ends[i + 1] - ends[j + 1]) < reach:
                close = True
                x, y = starts[i] - starts[j], starts[i + 1] - starts[j + 1]
                for way in (leaps, hops):
                    along, across = way[i] - way[j], way[i + 1] - way[j + 1]
                    for _ in range(CONTACT_CHECKS):
                        x += along
                        y += across
                        if x * x + y * y < contact * contact:
                            return True, True
    if task.bound is not None or task.n_walls:
        ranges = [
            (min(x + leap, turn, end), max(x + leap, turn, end))
            for x, leap, turn, end in zip(starts, leaps, turns, ends, strict=True)
        ]
        if task.bound is not None:
            edge = task.bound - MARGIN
            if any(low < -edge or high > edge for low, high in ranges):
                return True, close
        wide, tall = (size / 2 + task.radius + MARGIN for size in task.wall_size)
        for wall_x, wall_y in walls.tolist():
            for (left, right), (low, high) in zip(ranges[::2], ranges[1::2], strict=True):
                beside = left < wall_x + wide and right > wall_x - wide
                if beside and low < wall_y + tall and high > wall_y - tall:
                    return True, close
    position.ravel()[:] = ends
    velocity.ravel()[:] = speeds
    return False, close
