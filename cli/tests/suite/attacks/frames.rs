//! Hand-made HTTP/2 frames, for input that no client library sends.

/// Connection preface of a client.
pub const PREFACE: &[u8] = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n";

const HEADERS: u8 = 1;
const RST_STREAM: u8 = 3;
const SETTINGS: u8 = 4;
const PING: u8 = 6;

/// Returns one frame.
fn frame(kind: u8, flags: u8, stream: u32, payload: &[u8]) -> Vec<u8> {
    let length = &(payload.len() as u32).to_be_bytes()[1..];
    [length, &[kind, flags], &stream.to_be_bytes(), payload].concat()
}

/// Returns the preface with empty settings.
pub fn client_preface() -> Vec<u8> {
    [PREFACE, &frame(SETTINGS, 0, 0, &[])].concat()
}

/// Returns an empty settings frame.
pub fn settings() -> Vec<u8> {
    frame(SETTINGS, 0, 0, &[])
}

pub fn ping() -> Vec<u8> {
    frame(PING, 0, 0, b"knocking")
}

/// Returns the headers of a call, without the end of the stream.
pub fn call(stream: u32, path: &str) -> Vec<u8> {
    let mut block = vec![0x83, 0x86];
    // Literals without indexing: `:path`, `:authority`, `content-type`, `te`.
    let mut literal = |name: &[u8], value: &str| {
        block.extend_from_slice(name);
        block.push(value.len() as u8);
        block.extend_from_slice(value.as_bytes());
    };
    literal(&[0x04], path);
    literal(&[0x01], "farm");
    literal(&[0x0f, 0x10], "application/grpc");
    literal(&[0x00, 2, b't', b'e'], "trailers");
    let end_of_headers = 0x4;
    frame(HEADERS, end_of_headers, stream, &block)
}

/// Returns a frame that resets a stream.
pub fn reset(stream: u32) -> Vec<u8> {
    let cancel = 8u32;
    frame(RST_STREAM, 0, stream, &cancel.to_be_bytes())
}
