/** What lies over the picture: loading, and what went wrong. */

import type { PageError } from "../errors";
import { find, icon, make, setText } from "./dom";

export function showProgress(share: number, doing: string): void {
  const cover = find(HTMLElement, "#cover");
  const line = cover.querySelector(".doing");
  const bar = cover.querySelector(".bar");
  const fill = cover.querySelector(".bar span");
  const percent = Math.round(100 * Math.min(1, Math.max(0, share)));
  if (line instanceof HTMLElement) setText(line, doing);
  bar?.setAttribute("aria-valuenow", String(percent));
  if (fill instanceof HTMLElement) fill.style.transform = `scaleX(${percent / 100})`;
}

export function uncover(): void {
  find(HTMLElement, "#app").classList.remove("loading");
  find(HTMLElement, "#cover").classList.add("done");
}

/** A message in place of the picture, with a way to try again. */
export function showMessage(error: PageError): void {
  const cover = find(HTMLElement, "#cover");
  const heading = make("h2", "", error.title);
  const advice = make("p", "advice", error.advice);
  const again = make("button", "pill", "Reload");
  again.type = "button";
  again.dataset["control"] = "reload";
  again.style.paddingLeft = "16px";
  again.addEventListener("click", () => location.reload());
  const card = make("div", "card message");
  card.append(icon("alert"), heading, advice, again);
  cover.replaceChildren(card);
  cover.setAttribute("role", "alert");
  cover.classList.remove("done");
  find(HTMLElement, "#app").classList.remove("idle");
}
