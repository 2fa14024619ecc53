/** The reader's choices in the page's address, so that a link keeps them. Nothing else is stored. */

/** The part of the address after #, for one panel; `prefix` keeps its names from the others'. */
export class Link {
  constructor(prefix = "") {
    this.prefix = prefix;
  }

  /** The choices of the address that are among `defaults`, and the defaults of the others. */
  read(defaults) {
    const given = new URLSearchParams(location.hash.slice(1));
    const found = { ...defaults };
    for (const name of Object.keys(defaults)) {
      if (given.has(this.prefix + name)) found[name] = given.get(this.prefix + name);
    }
    return found;
  }

  /** Write choices that differ from the defaults into the address. */
  write(choices, defaults) {
    const now = new URLSearchParams(location.hash.slice(1));
    for (const [name, value] of Object.entries(choices)) {
      if (String(value) === String(defaults[name])) now.delete(this.prefix + name);
      else now.set(this.prefix + name, value);
    }
    try {
      history.replaceState(null, "", `#${now}`);
    } catch {
      // a page that may not change its address works without
    }
  }
}

/** In a notebook the address belongs to somebody else. */
export class NoLink {
  read(defaults) {
    return { ...defaults };
  }

  write() {}
}
