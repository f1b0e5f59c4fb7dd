"""Files of `xmarl-bench render` are readable, of the promised size, and written atomically."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path

import imageio_ffmpeg
import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image, ImageSequence
from xmarl_envs import make_task
from xmarl_envs.canvas import HEADER, LINE, SIZE
from xmarl_envs.colours import agent_colours
from xmarl_envs.render import FPS, Renderer

from tests.conftest import MakeBundle, RunCli
from xmarl_bench.explain.controls import CONTROLS
from xmarl_bench.policy import load_policy
from xmarl_bench.render import animation
from xmarl_bench.render.animation import (
    FILM_COLUMNS,
    FILM_ROWS,
    GIF_BYTES,
    LAST_FRAME,
    write_animation,
)  # fmt: skip
from xmarl_bench.render.recording import Recording, record

Picture = NDArray[np.uint8]


def recorded(max_cycles: int, n_agents: int = 3, team: str = "random") -> Recording:
    return record(make_task("blind_navigation_v0", n_agents), team, max_cycles=max_cycles)


def expected(recording: Recording, cycle: int) -> Picture:
    track = recording.track
    reach = float(np.abs(track.scene().track).max()) + recording.scenery.radius
    title = f"{recording.task.name}, {recording.team}"
    picture = Renderer(recording.scenery, reach=reach).draw(track.scene(cycle), title=title)
    assert picture is not None
    return picture


def wrong(one: Picture, other: Picture) -> float:
    """Fraction of pixels with a clearly different colour."""
    return float((np.abs(one.astype(np.float64) - other).max(axis=-1) > 40).mean())


@pytest.mark.slow
def test_a_gif_shows_the_episode_at_twice_real_time(tmp_path: Path) -> None:
    recording = recorded(30)
    written = write_animation(recording, tmp_path / "a.gif")
    with Image.open(tmp_path / "a.gif") as gif:
        frames = [(np.asarray(f.convert("RGB")), f.info["duration"]) for f in ImageSequence.Iterator(gif)]
        assert gif.info["loop"] == 0  # for ever
    assert len(frames) == written.frames == 31
    assert [shown for _, shown in frames] == [1000 / FPS] * 30 + [LAST_FRAME]
    for cycle in (0, 13, 30):
        assert frames[cycle][0].shape == (HEADER + SIZE, SIZE, 3)
        other = expected(recording, (cycle + 10) % 30)
        assert wrong(frames[cycle][0], expected(recording, cycle)) < 0.2 * wrong(frames[cycle][0], other)


@pytest.mark.slow
def test_a_gif_of_a_long_episode_skips_steps(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(animation, "GIF_FRAMES", 10)
    written = write_animation(recorded(30), tmp_path / "a.gif")
    with Image.open(tmp_path / "a.gif") as gif:
        shown = [frame.info["duration"] for frame in ImageSequence.Iterator(gif)]
    assert written.frames == len(shown) == 9  # steps 0, 4, ... 28 and 30
    assert shown == [4 * 1000 / FPS] * 7 + [2 * 1000 / FPS, LAST_FRAME]


@pytest.mark.slow
def test_a_large_gif_drops_frames_until_it_is_small(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = write_animation(recorded(30, 16), tmp_path / "whole.gif")
    assert whole.n_bytes <= GIF_BYTES
    limit = whole.n_bytes // 2
    monkeypatch.setattr(animation, "GIF_BYTES", limit)
    written = write_animation(recorded(30, 16), tmp_path / "a.gif")
    assert (tmp_path / "a.gif").stat().st_size == written.n_bytes <= limit
    with Image.open(tmp_path / "a.gif") as gif:
        shown = [frame.info["duration"] for frame in ImageSequence.Iterator(gif)]
    assert 2 < len(shown) == written.frames < whole.frames == 31
    assert sum(shown) == 30 * 1000 / FPS + LAST_FRAME  # the same duration


@pytest.mark.slow
def test_an_mp4_holds_every_step(tmp_path: Path) -> None:
    recording = recorded(30)
    written = write_animation(recording, tmp_path / "a.mp4")
    assert written.frames == 31
    reader = imageio_ffmpeg.read_frames(tmp_path / "a.mp4")
    about = next(reader)
    frames = [np.frombuffer(data, dtype=np.uint8).reshape(HEADER + SIZE, SIZE, 3) for data in reader]
    assert about["fps"] == FPS
    assert about["size"] == (SIZE, HEADER + SIZE)
    assert len(frames) == 31 + LAST_FRAME * FPS // 1000
    for cycle in (0, 13, 30):
        other = expected(recording, (cycle + 10) % 30)
        assert wrong(frames[cycle], expected(recording, cycle)) < 0.2 * wrong(frames[cycle], other)


@pytest.mark.slow
def test_a_png_shows_six_moments(tmp_path: Path) -> None:
    recording = recorded(30)
    assert write_animation(recording, tmp_path / "a.png").frames == 6
    with Image.open(tmp_path / "a.png") as image:
        sheet = np.asarray(image)
        assert image.format == "PNG"
    height, width = sheet.shape[0] // 2, sheet.shape[1] // 3
    for k, cycle in enumerate((0, 6, 12, 18, 24, 30)):
        panel = sheet[k // 3 * height :, k % 3 * width :][:height, :width]
        small = Image.fromarray(expected(recording, cycle)).resize((width, height), Image.Resampling.LANCZOS)
        np.testing.assert_array_equal(panel, np.asarray(small))


@pytest.mark.slow
def test_an_avif_holds_the_pictures_of_a_film_in_rows(tmp_path: Path) -> None:
    recording = recorded(46)
    assert write_animation(recording, tmp_path / "a.avif").frames == FILM_ROWS * FILM_COLUMNS
    with Image.open(tmp_path / "a.avif") as image:
        assert image.size == (FILM_COLUMNS * SIZE, FILM_ROWS * (HEADER + SIZE))
        sheet = np.asarray(image.convert("RGB"))
    for k in (0, 15, 23):
        row, column = divmod(k, FILM_COLUMNS)
        shown = sheet[row * (HEADER + SIZE) :, column * SIZE :][: HEADER + SIZE, :SIZE]
        other = expected(recording, (2 * k + 20) % 46)
        assert wrong(shown, expected(recording, 2 * k)) < 0.3 * wrong(shown, other)


@pytest.mark.slow
def test_explainers_stand_side_by_side_with_a_key(
    tmp_path: Path, make_bundle: MakeBundle, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(animation, "FILM_ROWS", 1)
    monkeypatch.setattr(animation, "FILM_COLUMNS", 2)
    policy, _ = load_policy(make_bundle())
    recording = record(make_task("blind_navigation_v0", 3), "small", policy, max_cycles=3)
    explainers = [CONTROLS["all-ones"], CONTROLS["self"]]
    write_animation(recording, tmp_path / "two.avif", *explainers)
    with Image.open(tmp_path / "two.avif") as image:
        both = np.asarray(image.convert("RGB"))
    height = HEADER + LINE + SIZE
    assert both.shape == (height, 2 * 2 * SIZE, 3)
    alone = []
    for explainer in explainers:
        write_animation(recording, tmp_path / "one.avif", explainer)
        with Image.open(tmp_path / "one.avif") as image:
            alone.append(np.asarray(image.convert("RGB"))[:height, :SIZE])
    for k in range(2):
        shown = both[:height, k * SIZE : (k + 1) * SIZE]
        assert wrong(shown, alone[k]) < 0.3 * wrong(shown, alone[1 - k])


@pytest.mark.parametrize("suffix", ["gif", "avif", pytest.param("mp4", marks=pytest.mark.slow), "png"])
def test_an_episode_of_one_step_is_drawn(
    suffix: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(animation, "FILM_ROWS", 1)
    frames = FILM_COLUMNS if suffix == "avif" else 2
    assert write_animation(recorded(1), tmp_path / f"a.{suffix}").frames == frames


@pytest.mark.slow
def test_the_explanation_is_drawn_over_all_but_the_last_picture(
    tmp_path: Path, make_bundle: MakeBundle
) -> None:
    policy, _ = load_policy(make_bundle())
    task = make_task("blind_navigation_v0", 3)
    recording = record(task, "small", policy, max_cycles=5)
    panels = []
    for explainer in (CONTROLS["all-ones"], CONTROLS["random"]):
        write_animation(recording, tmp_path / "a.png", explainer)
        with Image.open(tmp_path / "a.png") as image:
            sheet = np.asarray(image)
        rows, columns = sheet.shape[0] // 2, sheet.shape[1] // 3
        below_header = np.s_[:, rows // 8 :]
        panels.append(sheet.reshape(2, rows, 3, columns, 3).swapaxes(1, 2).reshape(6, rows, -1)[below_header])
    differ = (panels[0] != panels[1]).any(axis=(1, 2))
    np.testing.assert_array_equal(differ, [True, True, True, True, True, False])


@pytest.mark.slow
def test_the_same_episode_gives_the_same_bytes(tmp_path: Path) -> None:
    for suffix in ("gif", "png"):
        paths = [tmp_path / f"{k}.{suffix}" for k in range(2)]
        for path in paths:
            write_animation(recorded(3), path)
        assert paths[0].read_bytes() == paths[1].read_bytes()


@pytest.mark.slow
def test_render_on_the_command_line(run_cli: RunCli, make_bundle: MakeBundle, tmp_path: Path) -> None:
    out = tmp_path / "new folder" / "episode.gif"
    ran = run_cli(
        "render", "--policy", make_bundle(), "--explainer", "attention", "--agents", 4, "--seed", 3,
        "--episode", 2, "--max-cycles", 6, "--out", out,
    )  # fmt: skip
    assert ran.code == 0, ran.err
    assert ran.err == ""
    assert ran.out.startswith(f"{out}: 7 of 7 moments of episode 1000003000002, ")
    with Image.open(out) as gif:
        last = np.asarray(gif.convert("RGB")).reshape(-1, 3).astype(int)
    for colour in agent_colours(4):
        assert np.abs(last - colour).sum(axis=1).min() < 40
    assert [path.name for path in out.parent.iterdir()] == ["episode.gif"]


@pytest.mark.slow
def test_without_a_policy_the_heuristic_plays(run_cli: RunCli, tmp_path: Path) -> None:
    out = tmp_path / "a.png"
    ran = run_cli("render", "--task", "blind_navigation_v0", "--out", out)
    assert ran.code == 0, ran.err
    assert "done, success 1.00" in ran.out
    assert out.is_file()


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ([], ["plays any task", "blind_navigation_v0"]),
        (["--task", "blind_navigation"], ["'blind_navigation'", "did you mean"]),
        (["--task", "blind_passage_v0", "--agents", 6], ["1 to 5", "got 6"]),
        (["--task", "blind_navigation_v0", "--explainer", "attention"], ["team is 'heuristic'"]),
        (["--policy", "navigaton"], ["unknown policy 'navigaton'"]),
        (["--policy", "BUNDLE", "--task", "blind_passage_v0"], ["6 entries", "gives 8"]),
        (["--policy", "BUNDLE", "--explainer", "attentoin"], ["'attentoin'", "did you mean"]),
        (["--policy", "BUNDLE", "--seed", -1], ["seed"]),
        (["--policy", "BUNDLE", "--episode", -1], ["episode"]),
        (["--policy", "BUNDLE", "--max-cycles", 0], ["max_cycles"]),
        (["--policy", "BUNDLE", "--out", "a.avi"], ["a.avi", ".gif, .avif, .mp4, .png"]),
        (["--policy", "BUNDLE", "--out", "."], ["give a name that ends in"]),
    ],
)
def test_invalid_options_are_refused(
    arguments: list[str], said: list[str], run_cli: RunCli, make_bundle: MakeBundle, tmp_path: Path
) -> None:
    bundle = make_bundle()
    out = tmp_path / "out.gif"
    given = [bundle if argument == "BUNDLE" else argument for argument in arguments]
    ran = run_cli("render", *(given if "--out" in given else [*given, "--out", out]))
    assert ran.code == 2
    assert ran.out == ""
    assert len(ran.err.splitlines()) == 1
    assert all(words in ran.err for words in said), ran.err
    assert not out.exists()


def test_an_unwritable_file_is_refused_before_anything_is_played(
    run_cli: RunCli, make_bundle: MakeBundle, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "folder.gif").mkdir()
    (tmp_path / "file").write_text("")
    for out, said in (("folder.gif", "which is a folder"), ("file/a.gif", "cannot write to")):
        ran = run_cli("render", "--policy", make_bundle(), "--out", tmp_path / out)
        assert ran.code == 2
        assert said in ran.err
    not_there: Callable[[str], None] = lambda name: None  # noqa: E731
    monkeypatch.setattr(animation, "find_spec", not_there)
    ran = run_cli("render", "--policy", make_bundle(), "--out", tmp_path / "a.mp4")
    assert ran.code == 2
    assert "pip install 'xmarl-bench[video]'" in ran.err


@pytest.mark.slow
def test_a_failing_explainer_leaves_the_old_file(
    run_cli: RunCli, make_bundle: MakeBundle, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "a.gif"
    out.write_text("old")

    def crash(*_: object) -> None:
        raise RuntimeError("out of coffee")

    monkeypatch.setattr(Recording, "explain", crash)
    with pytest.raises(RuntimeError):
        run_cli("render", "--policy", make_bundle(), "--explainer", "attention", "--out", out)
    assert out.read_text() == "old"
    assert {path.name for path in tmp_path.iterdir()} == {"a.gif", "policies"}


def test_ffmpeg_comes_with_the_package() -> None:
    version = subprocess.run([imageio_ffmpeg.get_ffmpeg_exe(), "-version"], capture_output=True, check=True)
    assert version.stdout.startswith(b"ffmpeg")
