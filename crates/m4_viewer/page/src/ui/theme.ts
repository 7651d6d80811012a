/** Light or dark: as the system says, until the user says otherwise. */

const KEY = "minute4d-theme";
export type Theme = "light" | "dark";

const system = window.matchMedia("(prefers-color-scheme: light)");

/** Storage may be refused to a page from a file. */
function stored(): Theme | null {
  try {
    const v = localStorage.getItem(KEY);
    return v === "light" || v === "dark" ? v : null;
  } catch {
    return null;
  }
}

export function theme(): Theme {
  return document.documentElement.dataset["theme"] === "light" ? "light" : "dark";
}

function apply(next: Theme): void {
  document.documentElement.dataset["theme"] = next;
}

/** Follows the system from now on, unless the user chose before. */
export function startTheme(): void {
  const follow = (): void => apply(stored() ?? (system.matches ? "light" : "dark"));
  follow();
  system.addEventListener("change", follow);
}

export function toggleTheme(): Theme {
  const next = theme() === "light" ? "dark" : "light";
  apply(next);
  try {
    localStorage.setItem(KEY, next);
  } catch {
    // it lasts as long as the page then
  }
  return next;
}
