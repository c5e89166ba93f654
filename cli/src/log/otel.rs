//! Spans of tasks and sessions to an OpenTelemetry collector: OTLP over gRPC, in programs built with the feature `otel`, where
//! `OTEL_EXPORTER_OTLP_ENDPOINT` names one. The other usual `OTEL_` variables hold, too.

use crate::command::Cli;
use opentelemetry::trace::TracerProvider as _;
use opentelemetry_otlp::{ExporterBuildError, SpanExporter};
use opentelemetry_sdk::Resource;
use opentelemetry_sdk::trace::{SdkTracerProvider, Tracer};
use tokio::runtime::Runtime;
use tracing::Subscriber;
use tracing_opentelemetry::OpenTelemetryLayer;
use tracing_subscriber::registry::LookupSpan;

/// Sends spans until it is dropped, the last ones then.
#[derive(Debug)]
pub struct Spans {
    provider: SdkTracerProvider,
    /// What the exporter talks on; after the provider, which sends once more as it ends.
    _runtime: Runtime,
}

impl Drop for Spans {
    fn drop(&mut self) {
        if let Err(error) = self.provider.shutdown() {
            eprintln!("femc: the last spans were not sent: {error}");
        }
    }
}

/// Why no spans are sent.
#[derive(Debug, thiserror::Error)]
pub enum NoSpans {
    /// The settings make no sense.
    #[error("OTEL_EXPORTER_OTLP_ENDPOINT: {0}")]
    Exporter(#[from] ExporterBuildError),
    /// There is no thread for it.
    #[error("no thread can be started: {0}")]
    Thread(#[from] std::io::Error),
}

/// What collects spans.
type Layer<S> = OpenTelemetryLayer<S, Tracer>;

/// What sends spans, and the layer that collects them; `None`: no collector is named.
pub fn start<S>(cli: &Cli) -> Result<Option<(Spans, Layer<S>)>, NoSpans>
where
    S: Subscriber + for<'a> LookupSpan<'a>,
{
    if std::env::var_os("OTEL_EXPORTER_OTLP_ENDPOINT").is_none_or(|endpoint| endpoint.is_empty()) {
        return Ok(None);
    }
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build()?;
    let inside = runtime.enter();
    let exporter = SpanExporter::builder().with_tonic().build()?;
    drop(inside);
    let resource = Resource::builder().with_service_name(format!("femc-{}", cli.command.service())).build();
    let provider = SdkTracerProvider::builder().with_batch_exporter(exporter).with_resource(resource).build();
    let layer = tracing_opentelemetry::layer().with_tracer(provider.tracer("femc"));
    Ok(Some((Spans { provider, _runtime: runtime }, layer)))
}
