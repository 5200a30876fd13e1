"""A small CMU on this machine that can stall, cut short and lie."""

import hashlib
import io
import threading
import zipfile
from collections import defaultdict, deque
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

from localreg.motion.formats.asf import format_asf
from localreg.motion.formats.asf_amc import HEAD, frame_text
from tests.localreg.motion.strategies import make_calm_motion

PAGE = "/search.php?subjectnumber=%25&motion=%25"
ARCHIVE = "/allasfamc.zip"
TRIALS = {"02": {"01": ("walk", 120), "02": ("run/jog", 120)}, "60": {"01": ("salsa", 60)}}


class Site:
    """What the server has, what it does with the next requests, and what was asked.

    Attributes:
        files: content by path.
        tricks: by path, what to do with the next requests; then it behaves.
        asked: all requests, path and Range header.
        stall: how long a stalled answer stays silent [s].
    """

    def __init__(self):
        self.files = {}
        self.tricks = defaultdict(deque)
        self.asked = []
        self.stall = 60.0
        self.address = ""
        self.over = threading.Event()
        self.validators = True
        self.at_once = self.most_at_once = 0
        self.lock = threading.Lock()

    def play(self, path, *tricks):
        self.tricks[path].extend(tricks)

    def requests(self, path):
        return [asked_range for asked, asked_range in self.asked if asked == path]


def content(subject, number):
    """An AMC file of a few frames."""
    motion = make_calm_motion(int(subject) * 100 + int(number), count=60)
    frames = enumerate(motion.qpos, start=1)
    return (HEAD + "".join(frame_text(n, qpos, qpos[:3]) for n, qpos in frames)).encode()


def page():
    """The list of motions, in the form of CMU's page: tags are not closed."""
    rows = []
    for subject, trials in TRIALS.items():
        rows.append(f"<TR BGCOLOR=#909090><TD COLSPAN=3>Subject #{int(subject)} (someone)")
        for number, (description, rate) in trials.items():
            stem = f"/subjects/{subject}/{subject}_{number}"
            rows.append(
                f"<TR BGCOLOR=#F0F0F0><TD></TD><TD>{int(number)}</TD><TD>{description}</TD>"
                f'<TD><A HREF="{stem}.c3d">c3d</A> <A HREF="{stem}.amc">amc</A></TD><TD>{rate}</TD>'
            )
    return "<HTML><BODY><TABLE>" + "\n".join(rows) + "</TABLE></BODY></HTML>"


@contextmanager
def cmu_site():
    """A running server with two subjects, their trials, the index and the archive."""
    site = Site()
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        for subject, trials in TRIALS.items():
            skeleton = format_asf(make_calm_motion(int(subject), count=1).subject).encode()
            site.files[f"/subjects/{subject}/{subject}.asf"] = skeleton
            for number in trials:
                site.files[f"/subjects/{subject}/{subject}_{number}.amc"] = content(subject, number)
        for path, data in site.files.items():
            archive.writestr(f"all_asfamc{path}", data)
        archive.writestr("../../outside.amc", b"no")
        archive.writestr("all_asfamc/readme.txt", b"hello")
    site.files[ARCHIVE] = packed.getvalue()
    site.files[PAGE] = page().encode()
    server = ThreadingHTTPServer(("127.0.0.1", 0), _handler(site))
    server.daemon_threads = True
    site.address = f"http://127.0.0.1:{server.server_address[1]}"
    thread = threading.Thread(target=server.serve_forever, args=(0.02,))
    thread.start()
    try:
        yield site
    finally:
        site.over.set()
        server.shutdown()
        thread.join()
        server.server_close()


def _handler(site):
    class Handler(BaseHTTPRequestHandler):
        def log_message(self, *arguments):
            pass

        def do_GET(self):
            with site.lock:
                site.at_once += 1
                site.most_at_once = max(site.most_at_once, site.at_once)
                site.asked.append((self.path, self.headers.get("Range")))
                trick = site.tricks[self.path].popleft() if site.tricks[self.path] else ""
            try:
                self.answer(trick)
            except (BrokenPipeError, ConnectionResetError):
                pass
            finally:
                with site.lock:
                    site.at_once -= 1

        def answer(self, trick):
            data = site.files.get(self.path)
            if trick.isdigit() or data is None:
                self.send_response(int(trick or 404))
                self.send_header("Retry-After", "0")
                self.send_header("Content-Length", "0")
                self.end_headers()
                return
            if trick == "silence":
                site.over.wait(site.stall)
                return
            if trick == "web page":
                data = b"<html><body>busy, come again</body></html>"
            tag = f'"{hashlib.sha256(data).hexdigest()[:8]}"'
            start = self.first_byte(tag)
            rest = data[start:]
            sent = {"stall": len(rest) // 2, "cut": len(rest) // 2}.get(trick, len(rest))
            if trick == "short":  # claims to be shorter than it is
                rest = rest[: len(rest) * 2 // 3]
            self.send_response(206 if start else 200)
            if start:
                self.send_header("Content-Range", f"bytes {start}-{len(data) - 1}/{len(data)}")
            if site.validators:
                self.send_header("ETag", tag)
            self.send_header("Content-Length", str(len(rest)))
            self.end_headers()
            self.wfile.write(rest[:sent])
            if trick == "stall":
                self.wfile.flush()
                site.over.wait(site.stall)

        def first_byte(self, tag):
            asked = self.headers.get("Range")
            if asked is None or self.headers.get("If-Range") != tag:
                return 0
            return int(asked.removeprefix("bytes=").removesuffix("-"))

    return Handler
