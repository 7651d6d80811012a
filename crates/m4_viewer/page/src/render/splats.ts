/** The splats of a scene in a worker of their own: unpacked once, sliced and sorted for every instant. */

import type { Progress } from "../embedded";
import { PageError } from "../errors";
import type { Manifest } from "../scene";
import type { Texels } from "./columns";
import { type FromWorker, type ToWorker, sharedNow } from "./messages";
import type { Slice, SliceView } from "./slice";
import SplatWorker from "./worker?worker&inline";

/** An answer that takes longer does not come, milliseconds. */
const PATIENCE_MS = 60_000;

/** A slice that has come back. */
export interface Returned extends Slice {
  /** From the worker to the page, milliseconds. */
  readonly wayMs: number;
}

interface Waiting {
  take(message: FromWorker): boolean;
  fail(error: PageError): void;
}

export class Splats {
  private readonly worker: Worker;
  private readonly waiting: Waiting[] = [];
  private failure: PageError | null = null;

  constructor() {
    this.worker = new SplatWorker();
    this.worker.addEventListener("message", (event: MessageEvent<FromWorker>) => this.hear(event.data));
    this.worker.addEventListener("error", (event) => {
      event.preventDefault();
      this.fail(
        new PageError(
          "The page cannot sort the splats",
          `Its worker stopped (${event.message || "the browser does not say why"}). Reload to continue; a browser that allows workers and has enough memory shows the scene.`,
        ),
      );
    });
  }

  private hear(message: FromWorker): void {
    if (message.kind === "failed") this.fail(new PageError(message.title, message.advice));
    else if (this.waiting[0]?.take(message)) this.waiting.shift();
  }

  private fail(error: PageError): void {
    this.failure ??= error;
    for (const waiting of this.waiting.splice(0)) waiting.fail(error);
  }

  /** Asks for something; answers come in the order of the questions. */
  private ask<T>(message: ToWorker, transfer: Transferable[], read: (answer: FromWorker) => T | undefined): Promise<T> {
    if (this.failure) return Promise.reject(this.failure);
    return new Promise<T>((resolve, reject) => {
      let timer = 0;
      const watch = (): void => {
        window.clearTimeout(timer);
        timer = window.setTimeout(() => {
          this.fail(
            new PageError("Sorting the splats takes too long", "The worker did not answer within a minute. Reload the page."),
          );
        }, PATIENCE_MS);
      };
      this.waiting.push({
        take: (answer) => {
          const value = read(answer);
          if (value === undefined) {
            watch();
            return false;
          }
          window.clearTimeout(timer);
          resolve(value);
          return true;
        },
        fail: (error) => {
          window.clearTimeout(timer);
          reject(error);
        },
      });
      watch();
      this.worker.postMessage(message, transfer);
    });
  }

  /** Unpacks the payload, which is gone afterwards; the texels for the shaders, and how many the nodes take. */
  load(manifest: Manifest, bytes: Uint8Array<ArrayBuffer>, progress: Progress): Promise<{ texels: Texels; nodes: number }> {
    return this.ask({ kind: "load", manifest, bytes }, [bytes.buffer], (answer) => {
      if (answer.kind === "progress") progress(answer.share, answer.doing);
      return answer.kind === "loaded" ? { texels: answer.texels, nodes: answer.nodes } : undefined;
    });
  }

  /** The splats of an instant in their order. */
  slice(view: SliceView): Promise<Returned> {
    return this.ask({ kind: "slice", view }, [], (answer) =>
      answer.kind === "sliced" ? { ...answer.slice, wayMs: Math.max(0, sharedNow() - answer.sentMs) } : undefined,
    );
  }

  /** Ends the worker; what was asked of it is answered with an error. */
  close(): void {
    this.worker.terminate();
    this.fail(new PageError("Another scene replaced this one", "Reload the page if it does not show it."));
  }
}
