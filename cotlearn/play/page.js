/** The page: mounts each panel when it first comes into view, with its data. */

import { make } from "./controls.js";
import { unpack } from "./data.js";
import { Link } from "./link.js";
import { mount as pairs } from "./pairs.js";
import { mount as results } from "./results.js";
import { mount as robots } from "./robots.js";
import { mount as samples } from "./samples.js";

const PANELS = { pairs, samples, robots, results };

/** The panels that were mounted, by name. */
export const mounted = {};

/** The data of a panel; a page holds them as text until somebody wants to see them. */
const data = (name) => unpack(document.getElementById(`data-${name}`).textContent);

export async function open(name) {
  if (!(name in mounted)) mounted[name] = start(name);
  return mounted[name];
}

async function start(name) {
  const place = document.querySelector(`#${name} .panel`);
  const still = [...place.childNodes];
  try {
    const missing = lacks();
    if (missing) throw new Error(`This browser has no ${missing}, so the pictures stand still.`);
    const common = await data("common");
    const own = document.getElementById(`data-${name}`) ? await data(name) : {};
    const link = new Link(name === "results" ? "" : `${name}.`);
    place.replaceChildren();
    return PANELS[name](place, { ...common, ...own, link, sample });
  } catch (error) {
    const alert = make("p", { class: "sentence", role: "alert" }, error.message);
    place.replaceChildren(alert, ...still);
    throw error;
  }
}

/** What a panel needs and this browser lacks, in words; nothing if all is there. */
function lacks() {
  if (!document.createElement("canvas").getContext?.("2d")) return "canvas";
  return "DecompressionStream" in window ? "" : "DecompressionStream";
}

/** From panel 1 to panel 2, with the same pairs. */
async function sample({ data, coupling, w }) {
  if (!document.getElementById("samples")) {
    window.open(location.href.split("#")[0], "_top"); // this page stands in another one's frame
    return;
  }
  const panel = await open("samples");
  panel.follow(data, coupling, w);
  document.getElementById("samples").scrollIntoView({ block: "start" });
}

/** Called once at the end of the page. */
export function begin() {
  const only = new URLSearchParams(location.hash.slice(1)).get("embed");
  if (only in PANELS) embed(only);
  const watcher = new IntersectionObserver(
    (entries) => {
      for (const entry of entries) if (entry.isIntersecting) open(entry.target.id);
    },
    { rootMargin: "300px" },
  );
  for (const name of Object.keys(PANELS)) {
    const section = document.getElementById(name);
    if (section) watcher.observe(section);
  }
  if (!(only in PANELS)) show(linked());
  for (const anchor of document.querySelectorAll("nav a[href^='#']")) {
    anchor.addEventListener("click", (event) => {
      event.preventDefault(); // the address keeps the choices
      show(anchor.hash.slice(1));
    });
  }
}

/** The panel that the choices in the address belong to; nothing if there are none. */
function linked() {
  const [name] = new URLSearchParams(location.hash.slice(1)).keys();
  if (!name || name in PANELS) return "";
  const [prefix] = name.split(".");
  return prefix === name ? "results" : prefix;
}

/** Bring a panel into view, drawn. */
async function show(name) {
  const section = document.getElementById(name);
  if (!section) return;
  await open(name);
  section.scrollIntoView({ block: "start" });
}

/** Leave only one panel, for another page that frames this one. */
function embed(only) {
  document.documentElement.classList.add("embedded");
  for (const section of document.querySelectorAll("section")) {
    if (section.id !== only) section.remove();
  }
  const tell = () => parent.postMessage({ height: document.body.scrollHeight + 10 }, "*");
  new ResizeObserver(tell).observe(document.body);
}
