//! The token sent with every call.

use femc_trust::TokenFile;
use tonic::metadata::{Ascii, MetadataValue};
use tonic::service::Interceptor;
use tonic::service::interceptor::InterceptedService;
use tonic::transport::Channel;
use tonic::{Request, Status};

/// A channel that adds the token, if there is one, to every call.
pub(crate) type AuthorizedChannel = InterceptedService<Channel, TokenInterceptor>;

/// A token as a header; without a token, calls are unchanged.
#[derive(Debug, Clone)]
pub(crate) struct TokenInterceptor(Option<MetadataValue<Ascii>>);

impl TokenInterceptor {
    pub(crate) fn new(token_file: Option<&TokenFile>) -> Self {
        let header = |pass: &TokenFile| {
            let mut text: MetadataValue<Ascii> = format!("Bearer {}", pass.token().secret()).parse().ok()?;
            // A sensitive header is neither printed nor kept in header tables.
            text.set_sensitive(true);
            Some(text)
        };
        Self(token_file.and_then(header))
    }
}

impl Interceptor for TokenInterceptor {
    fn call(&mut self, mut request: Request<()>) -> Result<Request<()>, Status> {
        if let Some(token) = &self.0 {
            request.metadata_mut().insert("authorization", token.clone());
        }
        Ok(request)
    }
}
