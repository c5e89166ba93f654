"""Speaks to an encrypted coordinator with the ways that Python has: client.py URL JOB FILE."""

import http.client
import json
import os
import ssl
import sys
import urllib.error
import urllib.parse
import urllib.request

url, job, file = sys.argv[1:]
gets = [line.split() for line in open(file)]
context = ssl.create_default_context(cafile="ca.pem")


def bearer(user):
    return {"Authorization": "Bearer " + os.environ[user]}


change = {"Content-Type": "application/json", "X-Femc": "1"}
control = json.dumps({"jobs": [int(job)], "action": "retry"}).encode()
form = urllib.parse.urlencode({"token": os.environ["VIEWER"]})


def allowed(path, status):
    """The status for an operator, who may not read the record."""
    return 403 if path.startswith("/api/v1/audit") else int(status)


def check(ask):
    """All calls. `ask(method, path, headers, body)` returns status, headers and body, and follows no redirection."""
    for status, path in gets:
        found, _, body = ask("GET", path, bearer("OPERATOR"), None)
        assert found == allowed(path, status), (path, found)
        assert bool(body) == (found != 204), path
    found, _, body = ask("POST", "/api/v1/jobs/control", {**bearer("OPERATOR"), **change}, control)
    assert found == 200 and json.loads(body)["refused"][0]["code"] == "ended", (found, body)
    found, _, body = ask("POST", "/api/v1/workers/drain", {**bearer("VIEWER"), **change}, b" " * 60000)
    assert found == 403 and json.loads(body)["error"]["code"] == "forbidden", (found, body)
    found, headers, _ = ask("POST", "/login", {"Content-Type": "application/x-www-form-urlencoded"}, form.encode())
    assert found == 303 and headers["Location"] == "/", found
    cookie = headers["Set-Cookie"].split(";")[0]
    found, _, body = ask("GET", "/api/v1/me", {"Cookie": cookie}, None)
    assert found == 200 and json.loads(body)["name"] == "eve", (found, body)


def first_event(lines):
    """The kind of the first event of a feed."""
    for line in lines:
        text = line.decode().strip()
        if text.startswith("event: "):
            return text.removeprefix("event: ")


connection = http.client.HTTPSConnection(urllib.parse.urlsplit(url).netloc, context=context, timeout=60)


def by_http_client(method, path, headers, body):
    connection.request(method, path, body, headers)
    answer = connection.getresponse()
    return answer.status, answer.headers, answer.read()


check(by_http_client)
connection.request("GET", "/api/v1/feed", headers=bearer("VIEWER"))
assert first_event(connection.getresponse()) == "snapshot"
connection.close()
print("http.client: done")


class Stay(urllib.request.HTTPRedirectHandler):
    def redirect_request(self, *_):
        return None


opener = urllib.request.build_opener(urllib.request.HTTPSHandler(context=context), Stay)


def by_urllib(method, path, headers, body):
    request = urllib.request.Request(url + path, body, headers, method=method)
    try:
        answer = opener.open(request, timeout=60)
    except urllib.error.HTTPError as error:
        answer = error
    with answer:
        return answer.status, answer.headers, answer.read()


check(by_urllib)
with opener.open(urllib.request.Request(url + "/api/v1/feed", headers=bearer("VIEWER")), timeout=60) as feed:
    assert first_event(feed) == "snapshot"
print("urllib: done")

try:
    import requests
except ImportError:
    print("requests: not installed")
    sys.exit()

session = requests.Session()
# Else a certificate bundle that the environment names replaces `verify`.
session.trust_env = False
session.verify = "ca.pem"
session.cert = ("cert.pem", "key.pem")


def by_requests(method, path, headers, body):
    answer = requests.request(
        method, url + path, headers=headers, data=body, verify="ca.pem", allow_redirects=False, timeout=60
    )
    return answer.status_code, answer.headers, answer.content


check(by_requests)
# With a certificate, and the same connection for all.
for status, path in gets:
    assert session.get(url + path, timeout=60).status_code == int(status), path
with session.get(url + "/api/v1/feed", stream=True, timeout=60) as feed:
    assert first_event(feed.iter_lines()) == "snapshot"
print("requests: done")
