"""A farm's coordinator, as its public interface (proto/femc/v1/femc.proto) has it."""

import importlib
import itertools
import pathlib
import sys
import tempfile
import time

import grpc
from blake3 import blake3
from grpc_tools import protoc

PROTO = pathlib.Path(__file__).resolve().parents[2] / "proto"
# Every coordinator's certificate has this name, whatever address it is reached at.
COORDINATOR = "coordinator.femc.internal"
# Bytes of an artifact that travel in one message.
PIECE = 1 << 20
# A coordinator that goes away is waited for, seconds.
PATIENCE = 60.0
# Replies have 8 MiB at most.
LIMITS = [("grpc.max_receive_message_length", 8 << 20)]


def stubs():
    """The modules of messages and of calls, made anew from the .proto."""
    with tempfile.TemporaryDirectory() as folder:
        arguments = ["protoc", f"-I{PROTO}", f"--python_out={folder}", f"--grpc_python_out={folder}"]
        if protoc.main([*arguments, "femc/v1/femc.proto"]) != 0:
            raise SystemExit(f"{PROTO}: stubs cannot be made")
        sys.path.insert(0, folder)
        try:
            return tuple(importlib.import_module(f"femc.v1.{name}") for name in ("femc_pb2", "femc_pb2_grpc"))
        finally:
            sys.path.remove(folder)


wire, calls = stubs()


class Refused(Exception):
    """The coordinator said no: `reason` names a field of `Refusal`; None where it gave no reason of its own."""

    def __init__(self, error):
        details = dict(error.trailing_metadata() or ()).get("grpc-status-details-bin")
        self.refusal = wire.Refusal.FromString(details) if details else None
        self.reason = self.refusal.WhichOneof("reason") if self.refusal else None
        super().__init__(f"{error.code().name}: {error.details()}")


class Unreachable(Exception):
    """Nobody answers."""


def told(error):
    """A failed call, as what it means."""
    has_refusal = any(key == "grpc-status-details-bin" for key, _ in error.trailing_metadata() or ())
    if error.code() == grpc.StatusCode.UNAVAILABLE and not has_refusal:
        return Unreachable(error.details())
    return Refused(error)


def identity(path):
    """Certificate, key and authority of one of `femc ca issue`'s files: PEM, its own certificate first."""
    begin = "-----BEGIN "
    sections = [begin + section for section in pathlib.Path(path).read_text().split(begin)[1:]]
    certificates = [section for section in sections if "BEGIN CERTIFICATE-" in section]
    keys = [section for section in sections if "PRIVATE KEY-" in section]
    if len(certificates) != 2 or len(keys) != 1:
        raise ValueError(f"{path}: no identity; `femc ca issue user NAME --role submitter` makes one")
    return certificates[0].encode(), keys[0].encode(), certificates[1].encode()


class Farm:
    """A connection. `url` is http://HOST:PORT, or https://HOST:PORT with certificate, key and authority (PEM, bytes)."""

    def __init__(self, url, certificate=None, key=None, authority=None):
        scheme, _, address = url.partition("://")
        if "," in address:
            raise ValueError(f"{url}: this example takes one address")
        if scheme == "http":
            self.channel = grpc.insecure_channel(address, LIMITS)
        elif scheme == "https" and certificate:
            credentials = grpc.ssl_channel_credentials(authority, key, certificate)
            named = [("grpc.ssl_target_name_override", COORDINATOR)]
            self.channel = grpc.secure_channel(address, credentials, LIMITS + named)
        elif scheme == "https":
            raise ValueError(f"{url} is encrypted, which takes an identity")
        else:
            raise ValueError(f"{url}: write it like http://127.0.0.1:7878")
        self.jobs = calls.JobsStub(self.channel)
        self.artifacts = calls.ArtifactsStub(self.channel)

    def put(self, artifacts):
        """Puts those of these bytes into the store that are not there, in order; how many bytes that were."""
        named = {blake3(content).digest(): content for content in artifacts}
        missing = set(self._call(self.artifacts.Missing, wire.MissingRequest(digests=named)).digests)
        sent = {digest: content for digest, content in named.items() if digest in missing}
        for digest, content in sent.items():
            self._patiently(lambda: self._put(digest, content))
        return sum(map(len, sent.values()))

    def _put(self, digest, content):
        """Puts one, from the byte on that is wanted: an upload that was cut goes on."""
        offer = self.artifacts.Offer(wire.OfferRequest(digest=digest), timeout=PATIENCE)
        if offer.WhichOneof("answer") == "from":
            start = getattr(offer, "from")
            pieces = (content[at : at + PIECE] for at in range(start, len(content), PIECE))
            first = wire.PutRequest(digest=digest, offset=start)
            self.artifacts.Put(itertools.chain([first], (wire.PutRequest(piece=piece) for piece in pieces)))

    def submit(self, job, key):
        """Queues a job; its number. The same key is the same job, however often this is called."""
        return self._call(self.jobs.Submit, wire.SubmitRequest(job=job, key=key)).job

    def watch(self, job):
        """Its statuses until it has ended; a coordinator that goes away meanwhile is waited for."""
        since = time.monotonic()
        while True:
            try:
                for status in self.jobs.Watch(wire.WatchRequest(job=job)):
                    since = time.monotonic()
                    yield status
                    if status.state in (wire.JOB_STATE_DONE, wire.JOB_STATE_FAILED, wire.JOB_STATE_CANCELLED):
                        return
            except grpc.RpcError as error:
                if error.code() != grpc.StatusCode.UNAVAILABLE or time.monotonic() - since > PATIENCE:
                    raise told(error) from error
            time.sleep(0.2)

    def frames(self, job):
        """The finished frames, ascending."""
        return self._call(self.jobs.Frames, wire.FramesRequest(job=job)).frames

    def get(self, artifact):
        """An artifact's bytes, checked against its digest."""

        def bytes_of():
            replies = self.artifacts.Get(wire.GetRequest(digest=artifact.digest))
            return b"".join(reply.piece for reply in replies)

        content = self._patiently(bytes_of)
        if blake3(content).digest() != artifact.digest:
            raise ValueError(f"artifact {artifact.digest.hex()} came damaged")
        return content

    def _call(self, call, request):
        return self._patiently(lambda: call(request, timeout=PATIENCE))

    def _patiently(self, work):
        """Calls again for a while where the coordinator asks for that. Everything here can be repeated."""
        begun, answered = time.monotonic(), False
        while True:
            try:
                return work()
            except grpc.RpcError as error:
                failure = told(error)
                answered |= isinstance(failure, Refused)
                again = answered and error.code() == grpc.StatusCode.UNAVAILABLE
                if not again or time.monotonic() - begun > PATIENCE:
                    raise failure from error
                time.sleep(0.5)
