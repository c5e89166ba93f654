//! The token sent with every call.

use femc_trust::Pass;
use tonic::metadata::{Ascii, MetadataValue};
use tonic::service::Interceptor;
use tonic::service::interceptor::InterceptedService;
use tonic::transport::Channel;
use tonic::{Request, Status};

/// A channel that adds the token, if there is one, to every call.
pub(crate) type Bearing = InterceptedService<Channel, Bearer>;

/// A token as a header; without a token, calls are unchanged.
#[derive(Debug, Clone)]
pub(crate) struct Bearer(Option<MetadataValue<Ascii>>);

impl Bearer {
    pub(crate) fn of(pass: Option<&Pass>) -> Self {
        let header = |pass: &Pass| {
            let mut text: MetadataValue<Ascii> = format!("Bearer {}", pass.token().secret()).parse().ok()?;
            // A sensitive header is neither printed nor kept in header tables.
            text.set_sensitive(true);
            Some(text)
        };
        Self(pass.and_then(header))
    }
}

impl Interceptor for Bearer {
    fn call(&mut self, mut request: Request<()>) -> Result<Request<()>, Status> {
        if let Some(token) = &self.0 {
            request.metadata_mut().insert("authorization", token.clone());
        }
        Ok(request)
    }
}
