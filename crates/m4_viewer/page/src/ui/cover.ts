/** What lies over the image: the poster while the scene is unpacked, how far that is, and what went wrong. */

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
  bar?.setAttribute("data-known", "");
  if (fill instanceof HTMLElement) fill.style.transform = `scaleX(${percent / 100})`;
}

/** The scene takes the place of the poster. */
export function uncover(): void {
  find(HTMLElement, "#app").classList.remove("loading");
  find(HTMLElement, "#cover").classList.add("done");
  document.querySelector("#m4-poster")?.classList.add("done");
}

/** Takes the poster away before the scene is there: it shows another instant. */
export function dropPoster(): void {
  document.querySelector("#m4-poster")?.remove();
}

/** A message in place of the image, with a way to try again. */
export function showMessage(error: PageError): void {
  dropPoster();
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
  // in full screen nothing else is seen
  find(HTMLElement, "#app").append(cover);
  cover.classList.remove("done");
  find(HTMLElement, "#app").classList.remove("idle");
}
