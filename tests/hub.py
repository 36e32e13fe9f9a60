"""A Hugging Face Hub on this machine: as much of its interface as the client asks for."""

import base64
import hashlib
import json
import re
import threading
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from urllib.parse import unquote, urlsplit

TOKEN = "hf_that_may_write"


class FakeHub(ThreadingHTTPServer):
    """The server; `repositories` holds the branches of each, a branch its commits.

    A commit is a mapping of its files; the last one of a branch is what the branch has.
    """

    def __init__(self):
        super().__init__(("127.0.0.1", 0), _Handler)
        self.repositories = {}
        self.requests = []

    @property
    def url(self):
        return f"http://127.0.0.1:{self.server_port}"

    def files(self, repository, branch="main"):
        return self.repositories[repository][branch][-1]


def revision_of(files):
    return hashlib.sha1(repr(sorted(files.items())).encode()).hexdigest()


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"

    def log_message(self, *args):
        pass

    def do_HEAD(self):
        self.answer()

    def do_GET(self):
        self.answer()

    def do_POST(self):
        self.answer()

    def answer(self):
        path = unquote(urlsplit(self.path).path)
        body = self.rfile.read(int(self.headers.get("Content-Length", 0)))
        self.server.requests.append(f"{self.command} {path}")
        may_write = self.headers.get("authorization") == f"Bearer {TOKEN}"
        if self.command == "POST" and path != "/api/validate-yaml" and not may_write:
            return self.fail(401, "", "Invalid credentials in Authorization header")
        for pattern, method in _ROUTES:
            if match := re.fullmatch(pattern, path):
                return method(self, body, *match.groups())
        return self.fail(404, "", f"no {path}")

    def send(self, content, status=200, **headers):
        text = content if isinstance(content, bytes) else json.dumps(content).encode()
        self.send_response(status)
        self.send_header("Content-Length", str(len(text)))
        for name, value in headers.items():
            self.send_header(name.replace("_", "-"), value)
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(text)

    def fail(self, status, code, message):
        self.send({"error": message}, status, X_Error_Code=code, X_Error_Message=message)

    def commit_of(self, repository, revision):
        """The files of a revision; None, and the answer, if there is none."""
        branches = self.server.repositories.get(repository)
        if branches is None:
            self.fail(404, "RepoNotFound", "Repository not found")
            return None
        commits = {revision_of(files): files for branch in branches.values() for files in branch}
        commits |= {branch: history[-1] for branch, history in branches.items()}
        if revision not in commits:
            self.fail(404, "RevisionNotFound", f"Invalid rev id: {revision}")
        return commits.get(revision)

    def create(self, body):
        content = json.loads(body)
        name = "/".join(filter(None, (content.get("organization"), content["name"])))
        known = name in self.server.repositories
        self.server.repositories.setdefault(name, {"main": [{".gitattributes": b""}]})
        self.send({"url": f"{self.server.url}/{name}"}, 409 if known else 200)

    def branch(self, body, repository, branch):
        branches = self.server.repositories[repository]
        known = branch in branches
        branches.setdefault(branch, [branches["main"][-1]])
        self.send({}, 409 if known else 200)

    def info(self, body, repository, revision="main"):
        if (files := self.commit_of(repository, revision)) is not None:
            self.send({"id": repository, "sha": revision_of(files), "tags": [], "private": False})

    def tree(self, body, repository, revision):
        if (files := self.commit_of(repository, revision)) is not None:
            self.send([
                {"type": "file", "path": p, "size": len(content), "oid": revision_of({p: b""})}
                for p, content in files.items()
            ])  # fmt: skip

    def file(self, body, repository, revision, path):
        if (files := self.commit_of(repository, revision)) is not None:
            etag = hashlib.sha1(files[path]).hexdigest()
            self.send(files[path], ETag=f'"{etag}"', X_Repo_Commit=revision_of(files))

    def preupload(self, body, repository, revision):
        if self.commit_of(repository, revision) is not None:
            files = json.loads(body)["files"]
            answer = {"uploadMode": "regular", "shouldIgnore": False}
            self.send({"files": [{"path": file["path"], **answer} for file in files]})

    def commit(self, body, repository, revision):
        files = dict(self.commit_of(repository, revision))
        for line in filter(None, body.splitlines()):
            entry = json.loads(line)
            if entry["key"] == "file":
                content = base64.b64decode(entry["value"]["content"])
                files[entry["value"]["path"]] = content
            elif entry["key"] == "deletedFile":
                del files[entry["value"]["path"]]
        self.server.repositories[repository][revision].append(files)
        address = f"{self.server.url}/{repository}/commit/{revision_of(files)}"
        self.send({"success": True, "commitOid": revision_of(files), "commitUrl": address})


_REPOSITORY = r"([^/]+/[^/]+)"
_ROUTES = (
    (r"/api/repos/create", _Handler.create),
    (r"/api/validate-yaml", lambda self, body: self.send({})),
    (rf"/api/models/{_REPOSITORY}/branch/(.+)", _Handler.branch),
    (rf"/api/models/{_REPOSITORY}/revision/(.+)", _Handler.info),
    (rf"/api/models/{_REPOSITORY}/tree/([^/]+)", _Handler.tree),
    (rf"/api/models/{_REPOSITORY}/preupload/(.+)", _Handler.preupload),
    (rf"/api/models/{_REPOSITORY}/commit/(.+)", _Handler.commit),
    (rf"/api/models/{_REPOSITORY}", _Handler.info),
    (rf"/{_REPOSITORY}/resolve/([^/]+)/(.+)", _Handler.file),
)


@contextmanager
def fake_hub(monkeypatch, cache):
    """A Hub in place of the real one, with TOKEN logged in and the client's cache in `cache`."""
    import huggingface_hub
    from huggingface_hub import constants

    server = FakeHub()
    threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01}).start()
    monkeypatch.setattr(constants, "ENDPOINT", server.url)
    template = server.url + "/{repo_id}/resolve/{revision}/{filename}"
    monkeypatch.setattr(constants, "HUGGINGFACE_CO_URL_TEMPLATE", template)
    monkeypatch.setattr(constants, "HF_HUB_CACHE", str(cache))
    monkeypatch.setattr(constants, "HF_HUB_OFFLINE", False)
    monkeypatch.setattr(constants, "HF_TOKEN_PATH", str(cache / "token"))
    monkeypatch.setenv("HF_TOKEN", TOKEN)
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")
    huggingface_hub.close_session()  # which may have been opened without these settings
    try:
        yield server
    finally:
        server.shutdown()
        server.server_close()
        huggingface_hub.close_session()
