/** A panel in a notebook's cell, for anywidget. */

import { make } from "./controls.js";
import { unpack } from "./data.js";
import { mount as hands } from "./hands.js";
import { NoLink } from "./link.js";
import { mount as pairs } from "./pairs.js";
import { mount as results } from "./results.js";
import { mount as robots } from "./robots.js";
import { mount as samples } from "./samples.js";

const PANELS = { hands, pairs, results, robots, samples };

export function render({ model, el }) {
  el.classList.add("cotlearn-play");
  const place = make("div", { class: "panel" });
  el.append(place);
  let panel = null;
  unpack(model.get("data"))
    .then((data) => {
      panel = PANELS[model.get("name")](place, { ...data, link: new NoLink(), model });
    })
    .catch((error) => {
      place.replaceChildren(make("p", { class: "sentence", role: "alert" }, error.message));
    });
  return () => panel?.stop();
}
