"""Draws a recorded episode into one file: an animated gif, an mp4 video, or a sheet as png or avif."""

from __future__ import annotations

import io
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from itertools import chain
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, features
from rich.console import Console
from xmarl_envs.canvas import SIZE
from xmarl_envs.render import FPS, Renderer

from xmarl_bench.counted import counted
from xmarl_bench.errors import InputError
from xmarl_bench.explain.explainer import Explainer
from xmarl_bench.parallel.fan_out import in_order
from xmarl_bench.records.files import check_writable, write_atomically
from xmarl_bench.render.recording import Recording

Picture = NDArray[np.uint8]

GIF_FRAMES = 120  # at most; of longer episodes every second, third, ... step
GIF_BYTES = 2_000_000  # at most; frames are dropped until it fits
GIF_COLOURS = 96
FILM_ROWS, FILM_COLUMNS = 4, 6  # of an avif: pictures of a film, which a page plays and steps through
LAST_FRAME = 1500  # ms, to show the end
SHEET_PANELS, SHEET_COLUMNS = 6, 3
PANEL_WIDTH = 480  # pixels


@dataclass(frozen=True)
class Written:
    """Size of a written file."""

    frames: int
    n_bytes: int


def check_target(path: Path) -> None:
    """Raise InputError, before any work, if no animation can be written to `path`."""
    if path.suffix not in _FORMATS:
        raise InputError(
            f"cannot make {path}, whose format is unknown: give a name that ends in one of "
            f"{', '.join(_FORMATS)}."
        )
    if path.is_dir():
        raise InputError(f"cannot write to {path}, which is a folder: give the name of a file.")
    if path.suffix == ".avif" and not features.check("avif"):
        raise InputError(f"cannot make {path} with this Pillow: install 11.3 or newer, or make a .gif.")
    if path.suffix == ".mp4" and find_spec("imageio_ffmpeg") is None:
        raise InputError(
            f"cannot make {path} without imageio-ffmpeg: pip install 'xmarl-bench[video]', or make a .gif."
        )
    check_writable(path.parent)


def write_animation(
    recording: Recording, path: Path, *explainers: Explainer, progress: bool = False
) -> Written:
    """Draw the episode into one file, for each explainer with its explanation, side by side.

    The suffix of `path` gives the format: `.gif` or `.mp4`, both at twice real time, `.avif`, the pictures of
    a film in rows, or `.png`, six moments in rows. The picture after the last step has no explanation: no
    action follows it. Raises InputError as `check_target` and `Recording.explain` do.
    """
    check_target(path)
    choose, encode = _FORMATS[path.suffix]
    cycles = choose(recording.track.cycles)
    about = f"{recording.task.name}, {recording.team}"
    titles = [f"{about}, {explainer.name}" for explainer in explainers] or [about]
    masks = [_explain(recording, explainer, cycles, progress) for explainer in explainers] or [{}]
    renderer = Renderer(recording.scenery, reach=recording.reach, key=bool(explainers))

    def draw(cycle: int) -> Picture:
        scene, pairs = recording.track.scene(cycle), zip(titles, masks, strict=True)
        pictures = [renderer.draw(scene, of_cycle.get(cycle), title) for title, of_cycle in pairs]
        return np.hstack([each for each in pictures if each is not None])  # None: shown in a window

    frames, data = encode(in_order(draw, cycles, progress="draw" if progress else None), cycles)
    write_atomically(path, data)
    return Written(frames, len(data))


def _all(last: int) -> list[int]:
    return list(range(last + 1))


def _regular(last: int) -> list[int]:
    """At most GIF_FRAMES at equal distances, and the last."""
    return sorted({*range(0, last, -(-last // (GIF_FRAMES - 1))), last})


def _film(last: int) -> list[int]:
    """As many as a film has, including the first and the last; of a short episode some twice."""
    n = FILM_ROWS * FILM_COLUMNS
    return [round(k * last / (n - 1)) for k in range(n)]


def _moments(last: int) -> list[int]:
    """At most SHEET_PANELS, including the first and the last."""
    return sorted({round(k * last / (SHEET_PANELS - 1)) for k in range(SHEET_PANELS)})


def _explain(
    recording: Recording, explainer: Explainer, cycles: Sequence[int], progress: bool
) -> dict[int, NDArray[np.float32]]:
    explained = sorted({cycle for cycle in cycles if cycle < recording.track.cycles})
    console = Console(stderr=True, quiet=not progress)
    with console.status(f"{explainer.name} explains {counted(len(explained), 'step')}"):
        return dict(zip(explained, recording.explain(explainer, explained), strict=True))


def _gif(drawn: Iterator[Picture], cycles: Sequence[int]) -> tuple[int, bytes]:
    """Frames and bytes. All frames share one palette, so that still objects keep their colours."""
    pictures = list(drawn)
    some = np.concatenate([pictures[k] for k in _moments(len(pictures) - 1)])
    palette = Image.fromarray(some).quantize(GIF_COLOURS)
    frames = [
        Image.fromarray(picture).quantize(palette=palette, dither=Image.Dither.NONE) for picture in pictures
    ]
    every = 1
    while True:
        chosen = sorted({*range(0, len(frames), every), len(frames) - 1})
        data = _encode_gif([frames[k] for k in chosen], [cycles[k] for k in chosen])
        if len(data) <= GIF_BYTES or len(chosen) <= 2:
            return len(chosen), data
        every += 1


def _encode_gif(frames: Sequence[Image.Image], cycles: Sequence[int]) -> bytes:
    shown = [round(1000 / FPS) * int(steps) for steps in np.diff(cycles)] + [LAST_FRAME]
    file = io.BytesIO()
    frames[0].save(
        file, "GIF", save_all=True, append_images=frames[1:], duration=shown, loop=0, optimize=False
    )
    return file.getvalue()


def _avif(drawn: Iterator[Picture], cycles: Sequence[int]) -> tuple[int, bytes]:
    file = io.BytesIO()
    sheet = _sheet([Image.fromarray(picture) for picture in drawn], FILM_COLUMNS)
    sheet.save(file, "AVIF", quality=40, speed=8, max_threads=1)
    return len(cycles), file.getvalue()


def _sheet(panels: Sequence[Image.Image], most: int) -> Image.Image:
    """Pictures of equal size in rows of `most`."""
    width, height = panels[0].size
    n_columns = min(most, len(panels))
    sheet = Image.new("RGB", (n_columns * width, -(-len(panels) // n_columns) * height), "white")
    for k, panel in enumerate(panels):
        sheet.paste(panel, (k % n_columns * width, k // n_columns * height))
    return sheet


def _shrunk(picture: Picture) -> Image.Image:
    height, width = (PANEL_WIDTH * side // SIZE for side in picture.shape[:2])
    return Image.fromarray(picture).resize((width, height), Image.Resampling.LANCZOS)


def _mp4(drawn: Iterator[Picture], cycles: Sequence[int]) -> tuple[int, bytes]:
    import imageio_ffmpeg

    first = next(drawn)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "episode.mp4"
        writer = imageio_ffmpeg.write_frames(
            path, first.shape[1::-1], fps=FPS, codec="libx264", quality=8, ffmpeg_log_level="error"
        )
        writer.send(None)
        try:
            for picture in chain([first], drawn):
                writer.send(picture)
            for _ in range(round(LAST_FRAME / 1000 * FPS)):
                writer.send(picture)
        finally:
            writer.close()
        return len(cycles), path.read_bytes()


def _png(drawn: Iterator[Picture], cycles: Sequence[int]) -> tuple[int, bytes]:
    panels = [_shrunk(picture) for picture in drawn]
    file = io.BytesIO()
    _sheet(panels, SHEET_COLUMNS).save(file, "PNG", optimize=True)
    return len(panels), file.getvalue()


_FORMATS: dict[
    str, tuple[Callable[[int], list[int]], Callable[[Iterator[Picture], Sequence[int]], tuple[int, bytes]]]
] = {".gif": (_regular, _gif), ".avif": (_film, _avif), ".mp4": (_all, _mp4), ".png": (_moments, _png)}
