// A page that was opened as a file may start no worker: the search would stay empty. Here a hidden frame runs the
// same script instead, in the page's own thread. A page from a server keeps the browser's own workers.
if (location.protocol === "file:") {
  window.Worker = class extends EventTarget {
    #frame = document.createElement("iframe");
    #early = [];
    #ready = false;

    constructor(url) {
      super();
      this.onmessage = this.onerror = this.onmessageerror = null;
      this.#frame.hidden = true;
      document.body.append(this.#frame);
      const inner = this.#frame.contentWindow;
      inner.postMessage = (data) => setTimeout(() => this.#tell(data));
      const script = inner.document.createElement("script");
      script.src = new URL(url, location.href);
      script.onload = () => {
        this.#ready = true;
        this.#early.splice(0).forEach((data) => this.#give(data));
      };
      inner.document.head.append(script);
    }

    postMessage(data) {
      if (this.#ready) setTimeout(() => this.#give(data));
      else this.#early.push(data);
    }

    terminate() {
      this.#frame.remove();
    }

    #give(data) {
      const inner = this.#frame.contentWindow;
      if (inner) inner.dispatchEvent(new inner.MessageEvent("message", { data: structuredClone(data) }));
    }

    #tell(data) {
      const event = new MessageEvent("message", { data });
      this.onmessage?.(event);
      this.dispatchEvent(event);
    }
  };
}
