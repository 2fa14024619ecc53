/* For all pages of the site: buttons that copy code, and frames as high as what they show. */
"use strict";

// A panel of the playground says its height, which depends on the width of its frame.
addEventListener("message", ({ data, source }) => {
  if (!(data?.height > 0)) return;
  for (const frame of document.querySelectorAll("iframe.playground")) {
    if (frame.contentWindow === source) frame.style.height = `${data.height}px`;
  }
});

// A button on each block of code; outputs have none.

const copyText = (text) => {
  if (navigator.clipboard) return navigator.clipboard.writeText(text);
  const area = document.body.appendChild(document.createElement("textarea"));
  area.value = text;
  area.select();
  const done = document.execCommand("copy"); // a page that is no secure context has only this
  area.remove();
  return done ? Promise.resolve() : Promise.reject();
};

document.addEventListener("DOMContentLoaded", () => {
  for (const code of document.querySelectorAll("div.highlight > pre")) {
    if (code.closest(".cell_output")) continue;
    const button = document.createElement("button");
    button.type = "button";
    button.className = "copy";
    button.textContent = "copy";
    button.addEventListener("click", () => {
      const say = (word) => {
        button.textContent = word;
        setTimeout(() => (button.textContent = "copy"), 1500);
      };
      copyText(code.innerText.replace(/\n$/, "")).then(() => say("copied"), () => say("not copied"));
    });
    code.parentElement.append(button);
  }
});
