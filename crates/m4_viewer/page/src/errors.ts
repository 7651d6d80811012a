/** The error that the page shows instead of an image: what is wrong, and what to do. */
export class PageError extends Error {
  override readonly name = "PageError";

  constructor(
    /** A few words. */
    readonly title: string,
    /** A sentence: what was found, and what to do next. */
    readonly advice: string,
    options?: ErrorOptions,
  ) {
    super(`${title}. ${advice}`, options);
  }
}

/** The message of anything thrown. */
export function messageOf(error: unknown): string {
  return error instanceof Error ? error.message : String(error);
}

/** Anything thrown as a [PageError]. */
export function toPageError(error: unknown): PageError {
  if (error instanceof PageError) return error;
  return new PageError(
    "Internal error of the page",
    `${messageOf(error)}. Reloading may help; if it does not, please report this text.`,
    { cause: error },
  );
}
