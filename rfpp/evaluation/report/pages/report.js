"use strict";

// A range input lies invisibly over each picture: it brings pointer, touch, keyboard and screen readers.
for (const wipe of document.querySelectorAll(".wipe")) {
  const slider = wipe.querySelector("input");
  const show = () => {
    wipe.style.setProperty("--at", `${slider.value}%`);
    slider.setAttribute("aria-valuetext", `${slider.value}% prediction`);
  };
  slider.addEventListener("input", show);
  show();
}

const $ = (id) => document.getElementById(id);
const gallery = $("gallery");
const scenes = [...gallery.children];

// A value that is not a number is as bad as can be: first where the worst are, else last.
function byOrder() {
  const option = $("order").selectedOptions[0];
  const [name, sign] = option.value.split(" ");
  const none = "worstFirst" in option.dataset ? -Infinity : Infinity;
  const key = (scene) => {
    const value = sign * Number(scene.dataset[name]);
    return Number.isNaN(value) ? none : value;
  };
  return (a, b) => {
    const [x, y] = [key(a), key(b)];
    return x < y ? -1 : x > y ? 1 : 0;
  };
}

function sort() {
  gallery.append(...scenes.sort(byOrder()));
}

function filter() {
  const [from, to] = [Number($("from").value), Number($("to").value)];
  $("fewest").textContent = from.toLocaleString("en");
  $("most").textContent = to.toLocaleString("en");
  for (const scene of scenes) {
    const triangles = Number(scene.dataset.triangles);
    const ofSplit = ["", scene.dataset.split].includes($("split").value);
    scene.hidden = !ofSplit || triangles < from || triangles > to;
  }
  const count = scenes.filter((scene) => !scene.hidden).length;
  $("shown").value = `${count} of ${scenes.length} scenes shown`;
}

// Neither end of the range passes the other: it takes it along.
$("from").addEventListener("input", () => {
  $("to").value = Math.max($("from").value, $("to").value);
});
$("to").addEventListener("input", () => {
  $("from").value = Math.min($("from").value, $("to").value);
});
for (const event of ["input", "change"]) {
  $("choose").addEventListener(event, filter);
  $("choose").addEventListener(event, sort);
}
$("choose").addEventListener("submit", (event) => event.preventDefault());

sort();
filter();
