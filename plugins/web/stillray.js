// Denoise the frames of a path tracer with a stillray frame graph (NAME.frame.onnx): one ONNX file
// that holds all stages, from repair to the picture, and hands its state from frame to frame.
// `stillray info --graph NAME` tells what each input means.

// Of each buffer: its channels (0: no axis of channels) and the value that says "not given".
const BUFFERS = {
  albedo: [3, -1],
  normal: [3, 0],
  depth: [0, 0],
  motion: [2, 1e7],
  samples: [0, -1],
  filter_spread: [0, -1],
};

const shapeOf = (height, width, channels) =>
  channels ? [height, width, channels] : [height, width];

export class Denoiser {
  #ort;
  #session;
  #state = {};
  #size = '';
  #running = Promise.resolve();

  /**
   * @param ort      onnxruntime-web, onnxruntime-web/webgpu or onnxruntime-node
   * @param session  of a frame graph; `Denoiser.load` opens one
   */
  constructor(ort, session) {
    this.#ort = ort;
    this.#session = session;
  }

  /**
   * Open a frame graph.
   *
   * @param ort        the ONNX Runtime to use
   * @param model      URL, path or bytes of NAME.frame.onnx
   * @param providers  tried in turn: 'webgpu', 'wasm'; in Node 'cpu'
   */
  static async load(ort, model, providers = ['wasm']) {
    const options = { executionProviders: providers, logSeverityLevel: 3 };
    if (providers[0] === 'webgpu') {
      // the state stays on the device: only the picture comes back
      options.preferredOutputLocation = Object.fromEntries(
        STATES.map((name) => [`next_${name}`, 'gpu-buffer']),
      );
    }
    const given = model instanceof ArrayBuffer ? new Uint8Array(model) : model;
    return new Denoiser(ort, await ort.InferenceSession.create(given, options));
  }

  /** Forget the past: the next frame begins anew, as after a cut. */
  reset() {
    this.#release(this.#state);
    this.#state = {};
  }

  /**
   * Denoise a frame.
   *
   * Frames run in the order of the calls. A frame of another size than the last begins anew.
   *
   * @param frame  { width, height, color, albedo?, normal?, depth?, motion?, samples?,
   *               filter_spread? }: row-major
   *               Float32Array from the top left; color, albedo and normal with 3 values a pixel,
   *               motion with 2 (pixels to where the point was in the last frame, x right, y
   *               down), depth and samples with 1; samples may be one number,
   *               filter_spread is one: the standard deviation of the pixel filter, pixels
   * @returns Float32Array of width * height * 3 values, scene-linear radiance
   */
  denoise(frame) {
    const run = this.#running.then(() => this.#denoise(frame));
    this.#running = run.catch(() => {});
    return run;
  }

  /** Give back the session and what it holds. */
  async dispose() {
    await this.#running;
    this.reset();
    await this.#session.release();
  }

  async #denoise(frame) {
    const feeds = this.#buffers(frame);
    const size = `${frame.width} x ${frame.height}`;
    if (size !== this.#size) this.reset();
    this.#size = size;
    const before = this.#state;
    for (const name of this.#session.inputNames) {
      if (name.startsWith('past_')) feeds[name] = before[name] ?? this.#beginning(name);
    }
    const left = await this.#session.run(feeds);
    this.#state = {};
    for (const [name, tensor] of Object.entries(left)) {
      if (name.startsWith('next_')) this.#state[name.replace('next_', 'past_')] = tensor;
    }
    this.#release(before);
    return left.denoised.data;
  }

  #buffers(frame) {
    const { width, height } = frame;
    if (!(width > 0 && height > 0)) throw new RangeError('a frame needs width and height');
    const feeds = { color: this.#image('color', frame.color, height, width, 3) };
    for (const [name, [channels, neutral]] of Object.entries(BUFFERS)) {
      if (!this.#session.inputNames.includes(name)) continue; // graphs made before it was known
      const value = frame[name] ?? neutral;
      feeds[name] =
        typeof value === 'number'
          ? this.#filled(shapeOf(1, 1, channels), value)
          : this.#image(name, value, height, width, channels);
    }
    return feeds;
  }

  #image(name, values, height, width, channels) {
    const count = height * width * (channels || 1);
    if (!(values instanceof Float32Array) || values.length !== count) {
      throw new RangeError(`${name} must be a Float32Array of ${count} values, got ${values?.length}`);
    }
    return new this.#ort.Tensor('float32', values, shapeOf(height, width, channels));
  }

  #filled(shape, value) {
    const count = shape.reduce((product, size) => product * size, 1);
    return new this.#ort.Tensor('float32', new Float32Array(count).fill(value), shape);
  }

  /** Zeros: no past. Sizes that the graph leaves open are 1. */
  #beginning(name) {
    const { shape } = this.#session.inputMetadata.find((input) => input.name === name);
    return this.#filled(shape.map((size) => (typeof size === 'number' ? size : 1)), 0);
  }

  #release(state) {
    for (const tensor of Object.values(state)) tensor.dispose?.();
  }
}

const STATES = ['mean', 'guides', 'output', 'noise', 'numbers', 'albedo'];
