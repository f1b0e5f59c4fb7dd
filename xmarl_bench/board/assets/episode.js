// The first scored episode of an entry, alone or beside that of another explainer: play, pause and step.
"use strict";

// A film is one picture, of frames in rows: FILM_ROWS and FILM_COLUMNS of xmarl_bench/render/animation.py.
const FILM = { rows: 4, columns: 6, milliseconds: 250 };

function showEpisodes(row) {
  $("animation").hidden = !row.animated;
  if (!row.animated) return;
  const last = FILM.rows * FILM.columns - 1;
  const others = rows.filter((other) => other !== row && other.animated && other.policy === row.policy);
  const choice = $("beside"), slider = $("frame"), play = $("play");
  let films = [], timer = null;

  function draw() {
    const k = Number(slider.value), column = k % FILM.columns, line = Math.floor(k / FILM.columns);
    for (const film of films) {
      film.style.backgroundPosition = `${(100 * column) / (FILM.columns - 1)}% ${(100 * line) / (FILM.rows - 1)}%`;
    }
    slider.setAttribute("aria-valuetext", `picture ${k + 1} of ${last + 1}`);
  }

  function run(playing) {
    clearInterval(timer);
    timer = playing ? setInterval(() => { slider.value = (Number(slider.value) + 1) % (last + 1); draw(); }, FILM.milliseconds) : null;
    play.textContent = playing ? "Pause" : "Play";
  }

  function step(by) {
    run(false);
    slider.value = Number(slider.value) + by;
    draw();
  }

  function film(of) {
    const label = `The first episode of ${of.policy.name}, seen from above; arrows between agents are wider the more their messages matter, by ${of.explainer}.`;
    const node = element("div", { class: "film", role: "img", "aria-label": label });
    node.style.backgroundImage = `url("animations/${of.id}.avif")`;
    node.style.backgroundSize = `${100 * FILM.columns}% ${100 * FILM.rows}%`;
    films.push(node);
    return element("figure", {}, node, element("figcaption", { class: "dim" }, of.explainer));
  }

  function arrange() {
    films = [];
    const other = others.find(({ id }) => id === choice.value);
    $("films").replaceChildren(...[row, other].filter(Boolean).map(film));
    draw();
  }

  choice.replaceChildren(element("option", { value: "" }, "nothing"), ...others.map((other) => element("option", { value: other.id }, other.explainer)));
  choice.closest("label").hidden = others.length === 0;
  slider.max = last;
  choice.addEventListener("change", arrange);
  slider.addEventListener("input", () => { run(false); draw(); });
  play.addEventListener("click", () => run(timer === null));
  $("back").addEventListener("click", () => step(-1));
  $("on").addEventListener("click", () => step(1));
  arrange();
  run(!matchMedia("(prefers-reduced-motion: reduce)").matches);
}
