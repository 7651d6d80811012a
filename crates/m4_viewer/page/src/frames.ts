/** Frames of the source clip, decoded when they are needed: in runs, each from a frame at which decoding can begin. */

import { PageError, messageOf } from "./errors";
import type { FrameIndex } from "./scene";

/** Runs that are kept decoded: the one in view, the next, and one that the pointer asks for. */
const KEEP = 3;

export class SourceFrames {
  private readonly kept = new Map<number, Promise<ImageBitmap[]>>();
  /** One run at a time: devices have few decoders. */
  private last: Promise<unknown> = Promise.resolve();

  constructor(
    readonly index: FrameIndex,
    private readonly bytes: Uint8Array<ArrayBuffer>,
  ) {}

  get count(): number {
    return this.index.offsets.length - 1;
  }

  /** Frame `i`; rejects with a [PageError] where it cannot be decoded. */
  async frame(i: number): Promise<ImageBitmap> {
    const { key_every } = this.index;
    const run = Math.floor(i / key_every);
    const images = this.run(run);
    // the next one is needed soon, at the end the first
    if (2 * (i % key_every) >= key_every) {
      this.run((run + 1) % Math.ceil(this.count / key_every)).catch(() => undefined);
    }
    const image = (await images)[i % key_every];
    if (!image) throw damaged(`frame ${i} is missing`);
    return image;
  }

  private run(run: number): Promise<ImageBitmap[]> {
    const known = this.kept.get(run);
    const images = known ?? this.last.catch(() => undefined).then(() => this.decoded(run));
    if (!known) this.last = images;
    // the newest at the end
    this.kept.delete(run);
    this.kept.set(run, images);
    const [oldest] = this.kept;
    if (oldest && this.kept.size > KEEP) {
      this.kept.delete(oldest[0]);
      oldest[1].then(
        (old) => old.forEach((image) => image.close()),
        () => undefined,
      );
    }
    return images;
  }

  private async decoded(run: number): Promise<ImageBitmap[]> {
    const { codec, width, height, key_every, offsets } = this.index;
    const config: VideoDecoderConfig = { codec, codedWidth: width, codedHeight: height };
    if (!("VideoDecoder" in window)) {
      throw cannot("It has no WebCodecs, or offers them to https:// and local files alone");
    }
    const answer = await VideoDecoder.isConfigSupported(config);
    if (!answer.supported) throw cannot(`It does not decode ${codec} (H.264)`);
    const images: Promise<ImageBitmap>[] = [];
    const decoder = new VideoDecoder({
      output: (frame) => {
        const image = createImageBitmap(frame).finally(() => frame.close());
        // where decoding fails, nothing waits for the images before
        image.catch(() => undefined);
        images[frame.timestamp] = image;
      },
      // `flush` fails as well
      error: () => undefined,
    });
    try {
      decoder.configure(config);
      const first = run * key_every;
      for (let i = first; i < Math.min(first + key_every, this.count); i++) {
        const data = this.bytes.subarray(offsets[i], offsets[i + 1]);
        decoder.decode(new EncodedVideoChunk({ type: i === first ? "key" : "delta", timestamp: i - first, data }));
      }
      await decoder.flush();
      return await Promise.all(images);
    } catch (error) {
      throw damaged(messageOf(error));
    } finally {
      if (decoder.state !== "closed") decoder.close();
    }
  }
}

function cannot(why: string): PageError {
  return new PageError("This browser cannot show the input frames", `${why}. The scene itself is complete.`);
}

function damaged(why: string): PageError {
  return new PageError("These input frames are damaged", `${why}. Download the file again, or export it again.`);
}
