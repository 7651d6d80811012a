/** What the page tells in place of a picture: what is wrong, and what to do. */
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
    "The page met an error of its own",
    `${messageOf(error)}. Reloading may help; if it does not, please report this text.`,
    { cause: error },
  );
}
