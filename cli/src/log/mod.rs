//! The log on stderr. `FEMC_LOG` (`LEVEL` or `TARGET=LEVEL,...`) overrides the flags.

#[cfg(feature = "otel")]
mod otel;

use crate::args::{ColorChoice, LogFormat};
use crate::command::Cli;
use femc_worker::{TASK_LOG_LEVEL, TaskLogs};
use std::io::{self, IsTerminal};
use tracing_subscriber::filter::{LevelFilter, Targets};
use tracing_subscriber::layer::{Layer, SubscriberExt};
use tracing_subscriber::util::SubscriberInitExt;

/// Logging resources that live until the end of the program.
#[derive(Debug)]
pub struct Logging {
    #[cfg(feature = "otel")]
    _spans: Option<otel::Spans>,
}

/// Starts logging as the flags require, until the returned value is dropped.
pub fn start(cli: &Cli) -> Logging {
    let own = |level| {
        ["femc", "femc_coordinator", "femc_worker", "femc_schedule"]
            .map(|target| (target, LevelFilter::from_level(level)))
    };
    let service = Targets::new().with_default(LevelFilter::WARN).with_targets(own(tracing::Level::INFO));
    let flags = match (cli.common.quiet, cli.common.verbose) {
        (true, _) => Targets::new().with_default(LevelFilter::ERROR),
        (_, 0) if cli.command.is_service() => service,
        (_, 0) => Targets::new().with_default(LevelFilter::ERROR),
        (_, 1) => service,
        (_, 2) => Targets::new().with_default(LevelFilter::INFO).with_targets(own(tracing::Level::DEBUG)),
        _ => Targets::new().with_default(LevelFilter::TRACE),
    };
    let requested = std::env::var("FEMC_LOG").ok().map(|text| text.parse::<Targets>().map_err(|error| (text, error)));
    let (filter, refused) = match requested {
        None => (flags, None),
        Some(Ok(requested)) => (requested, None),
        Some(Err(refused)) => (flags, Some(refused)),
    };
    let colored = match cli.common.color {
        ColorChoice::Always => true,
        ColorChoice::Never => false,
        ColorChoice::Auto => io::stderr().is_terminal() && std::env::var_os("NO_COLOR").is_none(),
    };
    let lines = tracing_subscriber::fmt::layer().with_writer(io::stderr);
    let lines = match cli.common.log_format {
        LogFormat::Text => lines.with_ansi(colored).with_target(false).boxed(),
        LogFormat::Json => lines.json().flatten_event(true).with_span_list(false).boxed(),
    };
    // Task logs get their records regardless of the filter for stderr.
    let level = LevelFilter::from_level(TASK_LOG_LEVEL);
    let tasks = TaskLogs.with_filter(Targets::new().with_default(LevelFilter::WARN).with_target("femc", level));
    let log = tracing_subscriber::registry().with(lines.with_filter(filter)).with(tasks);
    #[cfg(not(feature = "otel"))]
    let logging = {
        log.init();
        Logging {}
    };
    #[cfg(feature = "otel")]
    let logging = {
        let (spans, layer, fault) = match otel::start(cli) {
            Ok(Some((spans, layer))) => (Some(spans), Some(layer), None),
            Ok(None) => (None, None, None),
            Err(fault) => (None, None, Some(fault)),
        };
        // Export the spans of the farm regardless of the filter for stderr. Spans of the network layers are not exported: the
        // exporter itself creates some.
        let own = Targets::new().with_targets(own(tracing::Level::INFO));
        log.with(layer.map(|layer| layer.with_filter(own))).init();
        if let Some(fault) = fault {
            tracing::error!("cannot send spans: {fault}");
        }
        Logging { _spans: spans }
    };
    if let Some((text, error)) = refused {
        tracing::error!("FEMC_LOG={text} is not a log filter ({error}); write LEVEL or TARGET=LEVEL,...");
    }
    logging
}
