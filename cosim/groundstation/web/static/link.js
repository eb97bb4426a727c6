// The WebSocket to the flight: connects, shows the token, connects again, and matches answers to requests.

const AGAIN_MS = 1000; // between two attempts; the server is on this machine
const SILENT_MS = 2000; // without a frame the link counts as lost: frames come every 50 ms
const ANSWER_MS = 5000;
const WRONG_TOKEN = 4401;

export class Link {
  /** `on.message(told)`, `on.state("connecting" | "live" | "silent" | "lost" | "over", why)`. */
  constructor(on) {
    this.on = on;
    this.token = document.querySelector('meta[name="token"]').content;
    this.waiting = new Map();
    this.number = 0;
    this.state = "";
    setInterval(() => this.look(), 250);
  }

  open() {
    this.say("connecting", "");
    this.heard = performance.now();
    const socket = (this.socket = new WebSocket(`ws://${location.host}/live`));
    socket.onopen = () => socket.send(JSON.stringify({ token: this.token }));
    socket.onmessage = (event) => this.take(JSON.parse(event.data));
    socket.onclose = (event) => this.closed(event);
  }

  take(told) {
    this.heard = performance.now();
    if (told.type === "answer") {
      this.waiting.get(told.id)?.(told);
      this.waiting.delete(told.id);
      return;
    }
    this.say("live", "");
    this.on.message(told);
  }

  closed(event) {
    for (const done of this.waiting.values()) done({ accepted: false, text: "the link was lost before an answer came" });
    this.waiting.clear();
    if (event.code === WRONG_TOKEN) return location.reload(); // a new session on the same port: take its page
    this.ended ||= event.code === 1001;
    this.say(this.ended ? "over" : "lost", event.reason);
    setTimeout(() => this.open(), AGAIN_MS);
  }

  look() {
    if (this.state === "live" && performance.now() - this.heard > SILENT_MS) this.say("silent", "");
  }

  say(state, why) {
    // an attempt in vain is no news
    if (state === this.state || (state === "connecting" && this.state !== "")) return;
    if (state === "live") this.ended = false;
    this.state = state;
    this.on.state(state, why);
  }

  get live() {
    return this.state === "live";
  }

  /** Ask for something; the answer as {accepted, result, text}. */
  ask(request, fields = {}) {
    return new Promise((done) => {
      if (!this.live) return done({ accepted: false, text: "there is no link" });
      const id = ++this.number;
      this.waiting.set(id, done);
      this.socket.send(JSON.stringify({ id, request, ...fields }));
      setTimeout(() => this.waiting.delete(id) && done({ accepted: false, text: "no answer" }), ANSWER_MS);
    });
  }

  /** Send without waiting for an answer; nothing is put in a queue for later. */
  tell(request, fields) {
    if (this.live && this.socket.bufferedAmount === 0) this.socket.send(JSON.stringify({ request, ...fields }));
  }
}
