//! The token that goes along with every call.

use femc_trust::Pass;
use tonic::metadata::{Ascii, MetadataValue};
use tonic::service::Interceptor;
use tonic::service::interceptor::InterceptedService;
use tonic::transport::Channel;
use tonic::{Request, Status};

/// A channel on which every call bears the token, if there is one.
pub(crate) type Bearing = InterceptedService<Channel, Bearer>;

/// A token as a header; none: calls go as they are.
#[derive(Debug, Clone)]
pub(crate) struct Bearer(Option<MetadataValue<Ascii>>);

impl Bearer {
    pub(crate) fn of(pass: Option<&Pass>) -> Self {
        let header = |pass: &Pass| {
            let mut text: MetadataValue<Ascii> = format!("Bearer {}", pass.token().secret()).parse().ok()?;
            // Neither printed nor kept in tables of headers.
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
