"""Draws the pictures of README.md and envs/README.md in docs/: `.venv/bin/python docs/make_pictures.py`.

`xmarl-bench render --task ... --agents ...` draws the same episodes.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from PIL import Image, ImageDraw, ImageFont
from xmarl_baselines.policies import shipped_policies
from xmarl_envs import TASKS, make_task
from xmarl_envs.render import Renderer

from xmarl_bench.explain.explainer import Explainer
from xmarl_bench.plugins.registry import find_explainer
from xmarl_bench.policy import load_policy
from xmarl_bench.policy.card import load_card
from xmarl_bench.policy.default_policies import default_policies
from xmarl_bench.render.recording import HEURISTIC, Recording, record

HERE = Path(__file__).parent
PANEL, MARGIN = (480, 528), 8  # pixels
CAPTION, TEXT = 52, 17  # pixels: height above a panel, and of its letters
CAPTIONS = {
    "blind_navigation_v0": "Navigation: each disc drives to the ring of its colour\n"
    "and must not touch another.",
    "blind_passage_v0": "Passage: the formation goes through a gap as wide\nas one disc, to the rings above.",
    "blind_discovery_v0": "Discovery: two discs have to reach the circle around\nthe landmark, sensed in the "
    "shaded disc only.",
}
EPISODES = {"blind_navigation_v0": 4, "blind_passage_v0": 1, "blind_discovery_v0": 0}  # of `render --episode`
CELL, EXPLAINER = ("blind_discovery_v0", 3), "attention"  # its default policy without the attention term


def moment(recording: Recording, cycle: int, explainer: Explainer | None = None) -> Image.Image:
    """The picture after `cycle` steps."""
    track = recording.track
    mask = None if explainer is None else recording.explain(explainer, range(track.cycles))[cycle]
    title = "" if explainer is None else f"{recording.team}, {explainer.name}"
    picture = Renderer(recording.scenery, reach=recording.reach).draw(track.scene(cycle), mask, title)
    assert picture is not None
    return Image.fromarray(picture).resize(PANEL, Image.Resampling.LANCZOS)


def row(panels: Sequence[Image.Image], captions: Sequence[str] = ()) -> Image.Image:
    """Panels side by side, each under its caption of two lines."""
    width, height = PANEL
    above = CAPTION if captions else 0
    sheet = Image.new("RGB", (len(panels) * (width + MARGIN) - MARGIN, height + above), "white")
    pen, font = ImageDraw.Draw(sheet), ImageFont.load_default(TEXT)
    for k, panel in enumerate(panels):
        sheet.paste(panel, (k * (width + MARGIN), above))
    for k, caption in enumerate(captions):
        pen.multiline_text((k * (width + MARGIN) + MARGIN, 4), caption, "black", font)
    return sheet


def heuristics() -> dict[str, Recording]:
    return {
        name: record(make_task(name, 3 if name == "blind_discovery_v0" else 5), HEURISTIC, episode=episode)
        for name, episode in EPISODES.items()
    }


def explained() -> Image.Image:
    """A policy's messages before and after an agent senses the landmark, and the end of the episode."""
    cards = default_policies(load_card(folder) for folder in shipped_policies().values())
    chosen = next(each for each in cards if (each.task, each.n_agents) == CELL)
    assert chosen.attention_entropy == 0  # default_policies sorts by it
    policy, card = load_policy(shipped_policies()[chosen.name])
    recording = record(make_task(card.task, card.n_agents), card.name, policy)
    sensed = int((recording.observations[..., -1] > 0).any(axis=1).argmax())
    explainer = find_explainer(EXPLAINER)
    last = recording.track.cycles
    finder = int(recording.observations[sensed, :, -1].argmax())
    mask = recording.explain(explainer, range(last))[sensed]
    assert (mask.argmax(axis=1) == finder).all()  # what the second caption says
    panels = [moment(recording, k, explainer) for k in (sensed - 1, sensed)] + [moment(recording, last)]
    captions = (
        "Nobody senses the landmark yet. An arrow: a message,\n"
        "as thick as it matters; a ring: an agent's own.",
        f"Agent {finder} senses it: now all listen to agent {finder},\nalthough nobody sees anybody.",
        "Two agents have reached it: done.",
    )
    return row(panels, captions)


def pictures() -> dict[str, Image.Image]:
    """File name -> picture."""
    played = heuristics()
    assert played.keys() == TASKS.keys()
    panels = [moment(one, one.track.cycles // 2) for one in played.values()]
    made = {"tasks.png": row(panels, [CAPTIONS[name] for name in played])}
    for name, one in played.items():
        last = one.track.cycles
        made[f"{name}.png"] = row([moment(one, cycle) for cycle in (0, last // 2, last)])
    return {**made, "explanation.png": explained()}


def main() -> None:
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else HERE
    for name, picture in pictures().items():
        picture.save(folder / name, optimize=True)


if __name__ == "__main__":
    main()
