"""Pictures have the right shape and show every agent, what happens to it, and its explanation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from xmarl_envs import State, TaskParallelEnv, make_task
from xmarl_envs.canvas import HEADER, LINE, SIZE
from xmarl_envs.colours import INK, NEAR, PAPER, WALL, agent_colours
from xmarl_envs.render import Renderer
from xmarl_envs.scene import Scene, Track
from xmarl_envs.team_painter import STAR
from xmarl_envs.vector_env import VectorEnv

from tests.envs.pictures import at, count, darkness, drawn, rendered, scene_of, tasks


@pytest.mark.slow
@tasks
@pytest.mark.parametrize("n_agents", [1, 3, 5])
def test_every_agent_is_in_the_picture(name: str, n_agents: int) -> None:
    env = TaskParallelEnv(make_task(name, n_agents), render_mode="rgb_array")
    env.reset(seed=0)
    frame = rendered(env)
    assert frame.shape == (HEADER + SIZE, SIZE, 3)
    assert frame.dtype == np.uint8
    assert all(count(frame, colour) > 30 for colour in agent_colours(n_agents))
    assert (count(frame, WALL) > 1000) == (name == "blind_passage_v0")
    assert (count(frame, NEAR) > 1000) == (name == "blind_discovery_v0")
    assert not count(frame, agent_colours(n_agents + 1)[-1])
    env.close()


def test_up_is_up_and_right_is_right() -> None:
    task = make_task("blind_navigation_v0", 3)
    frame = drawn(task, scene_of((0.0, 0.0), (0.5, 0.0), (0.0, 0.5)))
    origin, right, up = (at(frame, colour) for colour in agent_colours(3))
    pixels = 0.5 * SIZE / 2 / (1.06 + task.radius)
    np.testing.assert_allclose(origin, [SIZE / 2, SIZE / 2], atol=2)
    np.testing.assert_allclose(right, [SIZE / 2 + pixels, SIZE / 2], atol=2)
    np.testing.assert_allclose(up, [SIZE / 2, SIZE / 2 - pixels], atol=2)


def test_goals_are_in_the_colour_of_their_agent() -> None:
    task = make_task("blind_navigation_v0", 2)
    far = scene_of((-0.5, -0.5), (0.5, -0.5))
    near = Scene(**{**vars(far), "targets": np.array([[0.5, 0.5], [-0.5, 0.5]])})
    for i, colour in enumerate(agent_colours(2)):
        new = (drawn(task, near) == np.array(colour)).all(-1) & ~(drawn(task, far) == np.array(colour)).all(
            -1
        )
        rows, columns = np.nonzero(new)
        assert rows.size > 50
        assert rows.mean() < HEADER + SIZE / 2
        assert (columns.mean() > SIZE / 2) == (i == 0)


def test_the_picture_widens_if_the_team_leaves_it() -> None:
    task = make_task("blind_navigation_v0", 2)
    frame = drawn(task, scene_of((7.0, 0.0), (0.0, -7.0)))
    assert all(count(frame, colour) > 5 for colour in agent_colours(2))
    # Earlier positions count as well, so that the picture does not change back and forth.
    start = scene_of((0.0, 0.0), (0.5, 0.0))
    back = scene_of((0.0, 0.0), (0.5, 0.0), track=np.array([[[0, 3.0], [0.5, 0]], [[0, 0], [0.5, 0]]]))
    blue = agent_colours(2)[1]
    assert at(drawn(task, back), blue)[0] < at(drawn(task, start), blue)[0]
    assert at(drawn(task, start, reach=3.0 + task.radius), blue) == at(drawn(task, back), blue)


def test_trails_lead_from_where_agents_were() -> None:
    task = make_task("blind_navigation_v0", 1)
    track = np.linspace([[-0.8, 0.0]], [[0.4, 0.0]], 100)
    trail, none = (drawn(task, scene_of((0.4, 0.0), track=t)) for t in (track, None))
    changed = np.nonzero((trail != none).any(axis=-1))
    pixel = SIZE / 2 / (1.06 + task.radius)
    assert abs(changed[1].min() - (SIZE / 2 - 0.8 * pixel)) <= 3
    assert abs(changed[1].max() - (SIZE / 2 + 0.3 * pixel)) <= 3
    assert np.ptp(changed[0]) <= 4
    old, new = (trail[HEADER + SIZE // 2, round(SIZE / 2 + x * pixel)].astype(int) for x in (-0.7, 0.25))
    assert np.abs(old - PAPER).sum() < np.abs(new - PAPER).sum()  # it fades


def test_colliding_agents_are_marked() -> None:
    task = make_task("blind_navigation_v0", 2)
    frame = drawn(task, scene_of((-0.5, 0.0), (0.5, 0.0), collided=1))
    assert count(frame, STAR) > 50
    assert at(frame, STAR)[0] > SIZE / 2
    assert not count(drawn(task, scene_of((-0.5, 0.0), (0.5, 0.0))), STAR)


def test_collisions_reward_and_end_come_from_the_episode() -> None:
    env = VectorEnv(make_task("blind_navigation_v0", 2), max_cycles=40)
    env.reset([0])
    track, total, collided = Track(env.state), 0.0, 0
    for cycle in range(1, 41):
        pull = env.state.position[:, ::-1] - env.state.position  # into each other
        step = env.step(5 * pull)
        track.add(env.state, step)
        scene = track.scene()
        total += step.reward[0].mean()
        collided += scene.collided.sum()
        assert scene.cycle == cycle
        assert scene.reward == step.reward[0].mean()
        assert scene.total == pytest.approx(total)
        np.testing.assert_array_equal(scene.track[-1], env.state.position[0])
        np.testing.assert_array_equal(scene.collided, step.agent_collision[0])
        assert scene.ended == ("time is over" if cycle == 40 else "")
    early = track.scene(3)
    assert (early.cycle, len(early.track), early.ended) == (3, 4, "")
    np.testing.assert_array_equal(early.track, scene.track[:4])
    assert track.cycles == 40
    assert collided > 0


def test_the_header_says_step_reward_and_return() -> None:
    task = make_task("blind_navigation_v0", 1)
    frames = []
    for change in ({}, {"cycle": 7}, {"reward": 1.5}, {"total": -3.0}, {"ended": "done"}):
        frames.append(drawn(task, Scene(**{**vars(scene_of((0.0, 0.0))), **change})))
    frames.append(drawn(task, scene_of((0.0, 0.0)), title="another title"))
    headers = {frame[:HEADER].tobytes() for frame in frames}
    assert len(headers) == len(frames)
    assert len({frame[HEADER:].tobytes() for frame in frames}) == 1


ONE_WAY = np.array([[0.0, 0.0], [1.0, 0.0]])  # from 0 to 1


def test_an_explanation_is_arrows_from_sender_to_receiver() -> None:
    task = make_task("blind_navigation_v0", 2)
    scene = scene_of((-0.6, 0.0), (0.6, 0.0))
    without = drawn(task, scene)[HEADER:]
    for mask, side in ((ONE_WAY, 1), (ONE_WAY.T, -1)):
        rows, columns = np.nonzero((drawn(task, scene, mask)[HEADER:] != without).any(axis=-1))
        thickness = np.bincount(columns, minlength=SIZE)
        (tip,) = np.flatnonzero(thickness == thickness.max())[:1] - SIZE / 2
        disc = 0.5 * SIZE / 2 / 1.16  # from the middle of the picture to the surface of the receiver
        assert disc - 25 < side * tip < disc
        assert abs(rows.mean() - SIZE / 2) < 12
    # Each on its own side and in its sender's colour, so that both are visible.
    both = drawn(task, scene, ONE_WAY + ONE_WAY.T)[HEADER:, SIZE // 2 - 50 : SIZE // 2 + 50]
    colours = agent_colours(2)
    first, second = (np.flatnonzero((both == np.array(each)).all(axis=(1, 2))) for each in colours)
    assert min(len(first), len(second)) > 3
    assert first.max() < second.min() or second.max() < first.min()


def test_arrows_lie_over_walls_and_a_key_names_them() -> None:
    task = make_task("blind_passage_v0", 2)
    scene = replace(scene_of((-0.5, -0.5), (-0.5, 0.5)), walls=np.array([[-0.5, 0.0]]))
    picture = Renderer(task, key=True).draw(scene, np.array([[0.0, 0.0], [1.0, 0.0]]))
    assert picture is not None
    assert picture.shape == (HEADER + LINE + SIZE, SIZE, 3)
    wall = picture[HEADER + LINE + SIZE // 2]
    assert (wall == np.array(WALL)).all(axis=-1).any()
    assert (wall == np.array(agent_colours(2)[0])).all(axis=-1).any()
    assert (picture[HEADER : HEADER + LINE] == np.array(INK)).all(axis=-1).any()
    plain = Renderer(task).draw(scene)
    assert plain is not None
    assert plain.shape == (HEADER + SIZE, SIZE, 3)


def test_arrows_and_rings_grow_with_the_mask() -> None:
    task = make_task("blind_navigation_v0", 2)
    scene = scene_of((-0.6, 0.0), (0.6, 0.0))
    middle = [darkness(drawn(task, scene, m * ONE_WAY), SIZE / 2, SIZE / 2) for m in (0.0, 0.2, 0.6, 1.0)]
    assert middle[0] < middle[1] < middle[2] < middle[3]
    column = SIZE / 2 - 0.6 * SIZE / 2 / 1.16
    ring = [
        darkness(drawn(task, scene, np.diag([m, 0.0])), column, SIZE / 2, 50) for m in (0.0, 0.2, 0.6, 1.0)
    ]
    assert ring[0] < ring[1] < ring[2] < ring[3]
    half = SIZE // 2  # agent 1 has no ring
    ringed, plain = (drawn(task, scene, mask)[HEADER:, half:] for mask in (np.diag([1.0, 0.0]), None))
    np.testing.assert_array_equal(ringed, plain)


@pytest.mark.slow
def test_an_explanation_of_a_crowded_team_is_also_shown_magnified() -> None:
    task = make_task("blind_passage_v0", 5)
    huddle = [(x - 0.8, y - 0.8) for x, y in ((0.0, 0.0), (0.1, 0.0), (-0.1, 0.0), (0.0, 0.1), (0.0, -0.1))]
    apart = [(0.4 * k - 0.8, -0.8) for k in range(5)]
    for team, larger in ((huddle, True), (apart, False)):
        with_mask, without = (drawn(task, scene_of(*team), mask) for mask in (np.full((5, 5), 0.2), None))
        for colour in agent_colours(5):
            assert (count(with_mask, colour) > 3 * count(without, colour)) == larger
        middle = np.s_[HEADER + 260 : HEADER + 380, 260:380]  # nothing is covered there
        np.testing.assert_array_equal(with_mask[middle], without[middle])


def test_agents_on_one_spot_are_drawn_with_their_explanation() -> None:
    task = make_task("blind_navigation_v0", 2)
    frame = drawn(task, scene_of((0.0, 0.0), (0.0, 0.0)), np.ones((2, 2)))
    assert count(frame, agent_colours(2)[1]) > 30


def test_a_target_is_drawn_as_a_landmark_if_the_task_has_ranges_and_as_a_goal_otherwise() -> None:
    """Both tasks have as many targets as agents here."""
    for name, landmark in (("blind_navigation_v0", False), ("blind_discovery_v0", True)):
        task = make_task(name, 1)
        scene = Scene(**{**vars(scene_of((-0.5, 0.0))), "targets": np.array([[0.5, 0.0]])})
        assert (count(drawn(task, scene), NEAR) > 100) == landmark


def test_an_episode_of_a_batch_is_drawn_alone() -> None:
    state = State(
        np.array([[[0.0, 0.0]], [[0.5, 0.5]]]), np.zeros((2, 1, 2)), np.zeros((2, 1, 2)), np.zeros((2, 0, 2))
    )
    scenes = [Track(state, episode).scene() for episode in (0, 1)]
    np.testing.assert_array_equal(scenes[1].track, [[[0.5, 0.5]]])
    state.position[:] = 9.0  # the next step overwrites what the state views
    np.testing.assert_array_equal(scenes[0].track, [[[0.0, 0.0]]])
