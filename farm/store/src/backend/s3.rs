//! Stores on S3-compatible servers: `s3://bucket/prefix` and the usual `AWS_` variables.
//!
//! The server must support `If-None-Match: *` on a put (create if absent). Amazon supports it, and so does moto's server, which the
//! tests use (`tests/s3`). An interrupted multipart upload leaves its parts in the bucket. They are unreadable and stay until the
//! bucket's rule for incomplete uploads removes them.

use std::sync::Arc;
use std::time::Duration;

use object_store::aws::AmazonS3Builder;
use object_store::path::Path;
use object_store::prefix::PrefixStore;
use object_store::{BackoffConfig, ObjectStore, RetryConfig};

use super::http::HttpsConnectorFactory;
use crate::StoreError;

/// Timeout of one S3 call with its retries; longer outages are retried per task.
const RETRY_TIMEOUT: Duration = Duration::from_secs(20);

/// Opens the store at `url`. No request is sent yet.
pub(crate) fn open(url: &str) -> Result<Arc<dyn ObjectStore>, StoreError> {
    let wrong = |message: &str| StoreError::Url { url: url.to_owned(), message: message.to_owned() };
    let rest = url.strip_prefix("s3://").ok_or_else(|| wrong("it does not begin with s3://"))?;
    let (bucket, prefix) = rest.split_once('/').unwrap_or((rest, ""));
    if bucket.is_empty() || !bucket.bytes().all(|byte| byte.is_ascii_alphanumeric() || b".-_".contains(&byte)) {
        return Err(wrong("a bucket name (letters, digits, `.`, `-` and `_`) must follow s3://"));
    }
    let prefix = Path::parse(prefix).map_err(|error| wrong(&error.to_string()))?;
    let retry = RetryConfig { backoff: BackoffConfig::default(), max_retries: 5, retry_timeout: RETRY_TIMEOUT };
    let bucket = AmazonS3Builder::from_env()
        .with_bucket_name(bucket)
        .with_http_connector(HttpsConnectorFactory)
        .with_retry(retry)
        .build()
        .map_err(|error| StoreError::Medium { store: url.to_owned(), error })?;
    if prefix.as_ref().is_empty() { Ok(Arc::new(bucket)) } else { Ok(Arc::new(PrefixStore::new(bucket, prefix))) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_address_has_a_bucket_and_perhaps_a_prefix() {
        for good in ["s3://bucket", "s3://bucket/", "s3://my.bucket-1/a/b", "s3://bucket/a/"] {
            open(good).unwrap();
        }
        for bad in ["s3://", "s3:///a", "http://bucket", "bucket", "s3://b?x/a", "s3://bucket/a//b", "s3://bucket/../x"]
        {
            assert!(matches!(open(bad), Err(StoreError::Url { .. })), "{bad}");
        }
    }
}
