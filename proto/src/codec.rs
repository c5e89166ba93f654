//! Messages as bytes, by prost. A number is written byte by byte, and into memory that is shared with the connection each byte
//! costs a call: small messages are written to memory of their own first.

use std::marker::PhantomData;

use bytes::BufMut as _;
use prost::Message;
use tonic::Status;
use tonic::codec::{BufferSettings, EncodeBuf};
use tonic_prost::{ProstCodec, ProstDecoder};

/// The codec of all services.
#[derive(Debug)]
pub(crate) struct Codec<T, U>(PhantomData<(T, U)>);

impl<T, U> Default for Codec<T, U> {
    fn default() -> Self {
        Self(PhantomData)
    }
}

impl<T: Message + Send + 'static, U: Message + Default + Send + 'static> tonic::codec::Codec for Codec<T, U> {
    type Encode = T;
    type Decode = U;
    type Encoder = Encoder<T>;
    type Decoder = ProstDecoder<U>;

    fn encoder(&mut self) -> Self::Encoder {
        Encoder { small: Vec::new(), message: PhantomData }
    }

    fn decoder(&mut self) -> Self::Decoder {
        ProstCodec::<T, U>::default().decoder()
    }
}

/// Writes messages of one stream.
#[derive(Debug)]
pub(crate) struct Encoder<T> {
    /// A small message.
    small: Vec<u8>,
    message: PhantomData<T>,
}

impl<T> Encoder<T> {
    /// Bytes up to which a message is small; what is larger is mostly bytes that need no writing one by one.
    const SMALL: usize = 16 << 10;
}

impl<T: Message> tonic::codec::Encoder for Encoder<T> {
    type Item = T;
    type Error = Status;

    fn encode(&mut self, message: T, out: &mut EncodeBuf<'_>) -> Result<(), Status> {
        let length = message.encoded_len();
        if length > Self::SMALL {
            return message.encode(out).map_err(|error| Status::internal(error.to_string()));
        }
        self.small.clear();
        self.small.reserve(length);
        message.encode_raw(&mut self.small);
        out.put_slice(&self.small);
        Ok(())
    }

    fn buffer_settings(&self) -> BufferSettings {
        BufferSettings::default()
    }
}
