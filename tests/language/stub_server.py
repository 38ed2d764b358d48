"""A stub of an OpenAI-compatible server, which answers as it is told to."""

import contextlib
import http.server
import json
import re
import threading
import time


class Stub:
    """behaviour: "good", "other side", "slow", "500", "malformed", "empty", "silent" or a text to answer
    with; asked: the questions; answer: question -> a good answer."""

    def __init__(self, answer):
        self.behaviour, self.asked, self.answer = "good", [], answer
        self.stopping = threading.Event()
        stub = self

        class Handler(http.server.BaseHTTPRequestHandler):
            def do_POST(self):
                body = json.loads(self.rfile.read(int(self.headers["Content-Length"])))
                stub.asked.append(body["messages"])
                if stub.behaviour in ("slow", "silent"):
                    stub.stopping.wait(5.0)
                    if stub.behaviour == "silent":
                        return
                status = 500 if stub.behaviour == "500" else 200
                self.send_response(status)
                self.send_header("Content-Type", "application/json")
                self.end_headers()
                with contextlib.suppress(OSError):  # who asked may have lost patience
                    self.wfile.write(stub.reply(body["messages"][-1]["content"]))

            def log_message(self, *arguments):
                pass

        self.server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        self.server.daemon_threads = True
        self.url = f"http://127.0.0.1:{self.server.server_address[1]}/v1"
        threading.Thread(target=self.server.serve_forever, daemon=True).start()

    def reply(self, question):
        if self.behaviour == "malformed":
            return b"{not json"
        good = self.answer(question)
        mirror = {"right": "left", "left": "right"}
        other = re.sub(r"\b(right|left)\b", lambda side: mirror[side[0]], good)
        # Where there is no side to get wrong, it says that the robot won't stop.
        other = "I won't stop." if other == good else other
        text = {"good": good, "slow": good, "other side": other, "empty": ""}.get(self.behaviour, self.behaviour)
        message = {"role": "assistant", "content": text}
        choice = {"index": 0, "finish_reason": "stop", "message": message}
        return json.dumps(
            {"id": "1", "object": "chat.completion", "created": int(time.time()), "model": "m", "choices": [choice]}
        ).encode()

    def close(self):
        self.stopping.set()
        self.server.shutdown()
        self.server.server_close()


def good_answer(question):
    """A sentence with the side that the question names."""
    side = "right" if "right" in question else "left" if "left" in question else None
    if "Thank" in question:
        return "Thank you so much!"
    if "refused" in question:
        return "No worries, I will wait for you."
    if "not understand" in question:
        return "Sorry, what did you say?"
    who = "my" if "Say that you will" in question else "your"
    if side:
        return f"I'm happy to move to my {side}." if who == "my" else f"Would you kindly move to your {side}?"
    return "I'll happily wait for you." if who == "my" else "Would you kindly stop for me?"
