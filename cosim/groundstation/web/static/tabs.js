// The pages of the page: one is seen at a time; arrows, Home and End choose it.

import { get } from "./show.js";

export class Tabs {
  /** `shown(name)` is called for the page that is seen from now on. */
  constructor(shown) {
    this.tabs = [...document.querySelectorAll("[role=tab]")];
    this.shown = shown;
    this.tabs.forEach((tab, n) => {
      tab.addEventListener("click", () => this.choose(n));
      tab.addEventListener("keydown", (event) => {
        const last = this.tabs.length - 1;
        const to = { ArrowRight: n === last ? 0 : n + 1, ArrowLeft: n === 0 ? last : n - 1, Home: 0, End: last }[event.key];
        if (to === undefined) return;
        event.preventDefault();
        event.stopPropagation(); // the sticks have these keys too
        this.choose(to);
        this.tabs[to].focus();
      });
    });
    this.now = "flight";
  }

  choose(n) {
    this.tabs.forEach((tab, i) => {
      tab.setAttribute("aria-selected", String(i === n));
      tab.tabIndex = i === n ? 0 : -1;
      get(tab.getAttribute("aria-controls")).hidden = i !== n;
    });
    this.now = this.tabs[n].id.replace("tab-", "");
    this.shown(this.now);
  }
}
