//! Export of spans of tasks and sessions to an OpenTelemetry collector: OTLP over gRPC, in programs built with the feature `otel`,
//! if `OTEL_EXPORTER_OTLP_ENDPOINT` is set. The other usual `OTEL_` variables also apply.

use crate::command::Cli;
use opentelemetry::trace::TracerProvider as _;
use opentelemetry_otlp::{ExporterBuildError, SpanExporter};
use opentelemetry_sdk::Resource;
use opentelemetry_sdk::trace::{SdkTracerProvider, Tracer};
use tokio::runtime::Runtime;
use tracing::Subscriber;
use tracing_opentelemetry::OpenTelemetryLayer;
use tracing_subscriber::registry::LookupSpan;

/// Exporter of spans. Sends the last spans when it is dropped.
#[derive(Debug)]
pub struct Spans {
    provider: SdkTracerProvider,
    /// Runtime of the exporter. Must be dropped after the provider, which sends once more when it ends.
    _runtime: Runtime,
}

impl Drop for Spans {
    fn drop(&mut self) {
        if let Err(error) = self.provider.shutdown() {
            eprintln!("femc: cannot send the last spans: {error}");
        }
    }
}

/// Reasons why spans are not exported.
#[derive(Debug, thiserror::Error)]
pub enum SpanExportError {
    /// The settings are invalid.
    #[error("OTEL_EXPORTER_OTLP_ENDPOINT: {0}")]
    Exporter(#[from] ExporterBuildError),
    /// The exporter's thread cannot be started.
    #[error("cannot start a thread: {0}")]
    Thread(#[from] std::io::Error),
}

/// Layer that collects spans.
type Layer<S> = OpenTelemetryLayer<S, Tracer>;

/// Starts the exporter. Returns it with the layer that collects spans; `None`: no collector is set.
pub fn start<S>(cli: &Cli) -> Result<Option<(Spans, Layer<S>)>, SpanExportError>
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
