/* The search: what a word means comes first, then pages, then names of the library. */
"use strict";

var Scorer = {
  objNameMatch: 11,
  objPartialMatch: 6,
  objPrio: { 0: 0, 1: 0, 2: -5 }, // of Sphinx's 15 a module got before any page
  objPrioDefault: 0,
  title: 15,
  partialTitle: 7,
  term: 5,
  partialTerm: 2,
};

/** Entries of the glossary that hold all words of the query, the best one last. */
const glossaryEntries = (query) => {
  const { indexentries, docnames, titles, filenames } = Search._index;
  const words = query.toLowerCase().split(/\s+/).filter(Boolean);
  const found = [];
  for (const [entry, places] of Object.entries(indexentries))
    for (const [file, id] of places)
      if (docnames[file].endsWith("reference/glossary") && words.every((w) => entry.includes(w)))
        found.push([docnames[file], entry, `#${id}`, titles[file], 1000 - entry.length, filenames[file], "index"]);
  return words.length ? found.sort((a, b) => a[4] - b[4]).slice(-5) : [];
};

const rankGlossaryFirst = () => {
  const search = Search._performSearch;
  Search._performSearch = (query, ...terms) => [...search(query, ...terms), ...glossaryEntries(query)];
};

// the theme loads the search before this file, Sphinx's own pages load it after
if (typeof Search === "undefined") document.addEventListener("DOMContentLoaded", rankGlossaryFirst);
else rankGlossaryFirst();
