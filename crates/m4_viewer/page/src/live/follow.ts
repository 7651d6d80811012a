/** Follows a training run: its events to the panel, its newest scene to the viewer. */

import type { App } from "../app";
import { gunzip, isGzip } from "../bytes";
import { messageOf } from "../errors";
import { readManifest } from "../manifest";
import { splitLiveScene } from "../payload";
import type { LiveSource } from "../scene";
import { toast } from "../ui/notices";
import { readEvent } from "./events";
import type { LivePanel } from "./panel";

function withToken(address: string, token: string): URL {
  const url = new URL(address, location.href);
  url.searchParams.set("token", token);
  return url;
}

export class Follower {
  private readonly stream: EventSource;
  private loading = false;
  /** A newer scene landed while one was loading. */
  private again = false;
  private ended = false;

  constructor(
    private readonly app: App,
    private readonly source: LiveSource,
    private readonly panel: LivePanel,
    /** Called when the first scene is there. */
    private readonly onScene: () => void,
  ) {
    this.stream = new EventSource(withToken(source.events, source.token));
    this.stream.onmessage = (message: MessageEvent<unknown>) => this.take(message.data);
    this.stream.onopen = () => {
      if (panel.state === "disconnected") panel.set("training");
    };
    // the browser tries again by itself, unless the server refused for good
    this.stream.onerror = () => {
      if (!this.ended) panel.set("disconnected");
    };
  }

  private take(data: unknown): void {
    const event = typeof data === "string" ? readEvent(data) : null;
    if (!event) return;
    if (event.event === "metrics") {
      this.ended = false;
      this.panel.set("training");
      this.panel.push(event);
    } else if (event.event === "scene") {
      void this.load();
    } else {
      // the stream stays: a run that begins again in the same folder tells of itself
      this.ended = true;
      this.panel.set(event.ok ? "finished" : "failed");
    }
  }

  /** Fetches the newest scene; while one is on its way, the next one after it. */
  private async load(): Promise<void> {
    if (this.loading) {
      this.again = true;
      return;
    }
    this.loading = true;
    try {
      do {
        this.again = false;
        const response = await fetch(withToken(this.source.scene, this.source.token), { cache: "no-store" });
        if (!response.ok) throw new Error(`the server answered ${response.status}`);
        const raw = new Uint8Array(await response.arrayBuffer());
        const answer = isGzip(raw) ? await gunzip(raw, "scene") : raw;
        const { manifest, payload } = splitLiveScene(answer);
        const next = readManifest(manifest);
        await this.app.replace(next, payload.slice());
        this.onScene();
      } while (this.again);
    } catch (error) {
      // the image that is there stays; the next event tries again
      toast(`The newest scene did not arrive: ${messageOf(error)}`);
    } finally {
      this.loading = false;
    }
  }
}
