//! Reads one unidirectional stream: a header and exactly as many bytes as it announces.

use ldi_protocol::wire::{StreamHeader, code};
use quinn::{ReadError, RecvStream, VarInt};

/// Initial capacity. Grows as bytes arrive, so that an announcement alone cannot allocate much.
const FIRST_CAPACITY: usize = 256 * 1024;

/// A stream that brought no valid content.
#[derive(Debug, thiserror::Error)]
pub(super) enum StreamError {
    /// The server reset the stream, or the connection ended.
    #[error("broken off after {bytes} bytes")]
    Off {
        /// Received bytes.
        bytes: u64,
    },
    /// The content does not match the announcement.
    #[error("{0}")]
    Wrong(String),
}

/// The header.
pub(super) async fn header(stream: &mut RecvStream) -> Result<StreamHeader, StreamError> {
    let mut bytes = [0; StreamHeader::BYTES];
    stream.read_exact(&mut bytes).await.map_err(|_| StreamError::Off { bytes: 0 })?;
    StreamHeader::decode(&bytes).map_err(|e| {
        refuse(stream, code::BAD_STREAM);
        StreamError::Wrong(e.to_string())
    })
}

/// Reads the body of `header.bytes` bytes.
pub(super) async fn body(stream: &mut RecvStream, header: &StreamHeader) -> Result<Vec<u8>, StreamError> {
    let wanted = header.bytes as usize;
    let mut bytes = Vec::with_capacity(wanted.min(FIRST_CAPACITY));
    loop {
        match stream.read_chunk(usize::MAX, true).await {
            Ok(Some(chunk)) if bytes.len() + chunk.bytes.len() <= wanted => bytes.extend_from_slice(&chunk.bytes),
            Ok(Some(_)) => {
                refuse(stream, code::BAD_STREAM);
                return Err(StreamError::Wrong(format!("stream longer than the {wanted} bytes it announces")));
            }
            Ok(None) if bytes.len() == wanted => return Ok(bytes),
            Ok(None) => return Err(StreamError::Wrong(format!("{} of {wanted} bytes", bytes.len()))),
            Err(ReadError::Reset(_) | ReadError::ConnectionLost(_)) => {
                return Err(StreamError::Off { bytes: bytes.len() as u64 });
            }
            Err(e) => return Err(StreamError::Wrong(e.to_string())),
        }
    }
}

/// Tells the server to stop sending.
pub(super) fn refuse(stream: &mut RecvStream, code: u32) {
    let _ = stream.stop(VarInt::from_u32(code));
}
