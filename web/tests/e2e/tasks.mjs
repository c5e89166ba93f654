/**
 * Tasks of the main thread of pages, from the browser's trace: their duration, and the processor time in it. On a machine with other
 * work, only the processor time belongs to the page.
 */

const round = (v) => Math.round(v * 10) / 10;

/** Mark of the pages whose tasks count. The browser has pages of its own. */
const MARK = 'tasks of this page';

export class Tasks {
  pids = new Set();

  /** Begins to record the tasks of a page, from its next address on. */
  static async begin(browser, page) {
    const it = new Tasks();
    await page.addInitScript((mark) => performance.mark(mark), MARK);
    it.session = await browser.newBrowserCDPSession();
    it.session.on('Tracing.dataCollected', ({ value }) => it.events.push(...value));
    await it.start();
    return it;
  }

  async start() {
    this.events = [];
    await this.session.send('Tracing.start', {
      transferMode: 'ReportEvents',
      traceConfig: { recordMode: 'recordAsMuchAsPossible', includedCategories: ['toplevel', 'blink.user_timing', '__metadata'], excludedCategories: ['*'] },
    });
  }

  /**
   * Returns the tasks since the last call, and goes on to record.
   * - `mark`: name of a mark of the page; only tasks that end after it count
   */
  async take(mark = null) {
    const done = new Promise((resolve) => this.session.once('Tracing.tracingComplete', resolve));
    await this.session.send('Tracing.end');
    await done;
    const { events } = this;
    await this.start();
    for (const it of events) if (it.name === MARK) this.pids.add(it.pid);
    const threads = new Set(
      events
        .filter((it) => it.name === 'thread_name' && it.args.name === 'CrRendererMain' && this.pids.has(it.pid))
        .map((it) => `${it.pid} ${it.tid}`),
    );
    const from = events.find((it) => it.name === mark)?.ts ?? -Infinity;
    const tasks = events.filter(
      (it) => it.ph === 'X' && /RunTask$/.test(it.name) && threads.has(`${it.pid} ${it.tid}`) && it.ts + it.dur >= from,
    );
    const summary = (times) => ({
      above_50_ms: times.filter((ms) => ms > 50).length,
      above_100_ms: times.filter((ms) => ms > 100).length,
      longest_ms: round(Math.max(0, ...times)),
    });
    return {
      processor: { total_ms: round(tasks.reduce((sum, it) => sum + (it.tdur ?? 0) / 1000, 0)), ...summary(tasks.map((it) => (it.tdur ?? 0) / 1000)) },
      duration: summary(tasks.map((it) => it.dur / 1000)),
    };
  }
}
