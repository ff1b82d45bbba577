/** The last samples of one value, in memory that is taken once. */

export class Ring {
  private readonly times: Float64Array;
  private readonly values: Float64Array;
  private next = 0;
  length = 0;

  constructor(readonly capacity: number) {
    this.times = new Float64Array(capacity);
    this.values = new Float64Array(capacity);
  }

  push(time: number, value: number): void {
    this.times[this.next] = time;
    this.values[this.next] = value;
    this.next = (this.next + 1) % this.capacity;
    if (this.length < this.capacity) this.length += 1;
  }

  /** The value at `time`: that of the last sample before it; null before the first one. */
  *since(time: number): Generator<[number, number]> {
    const first = (this.next - this.length + this.capacity) % this.capacity;
    for (let i = 0; i < this.length; i += 1) {
      const at = (first + i) % this.capacity;
      const t = this.times[at] as number;
      if (t >= time) yield [t, this.values[at] as number];
    }
  }
}
