//! Encodes messages with prost. prost writes a number byte by byte, and each byte costs a call if the memory is shared with the
//! connection. So small messages are first written to a separate buffer.

use std::marker::PhantomData;

use bytes::BufMut as _;
use prost::Message;
use tonic::Status;
use tonic::codec::{BufferSettings, EncodeBuf};
use tonic_prost::{ProstCodec, ProstDecoder};

/// Codec of all services.
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

/// Encoder of the messages of one stream.
#[derive(Debug)]
pub(crate) struct Encoder<T> {
    /// Buffer for small messages.
    small: Vec<u8>,
    message: PhantomData<T>,
}

impl<T> Encoder<T> {
    /// Largest size in bytes of a small message. Larger messages consist mostly of byte strings, which are not written byte by
    /// byte.
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
