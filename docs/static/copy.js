/* A button on each block of code that copies it. Outputs have none. */
"use strict";

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
