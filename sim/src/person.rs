//! Who wants frames: asks until there is an answer.

use std::time::Duration;

use femc_model::{FrameRecord, JobId, JobStatus, Refusal};
use femc_proto::{CallError, Client};

use crate::hosts::coordinator_name;
use crate::network::{dial, url};
use crate::shared::Shared;
use crate::stage::{self, Stage};

/// Between two questions whether a job has ended.
const LOOK: Duration = Duration::from_millis(400);

/// Submits the job, waits for its end, fetches its frames; never gives up.
pub(crate) async fn person(shared: Shared, stage: &'static Stage) -> turmoil::Result {
    let job = insist(&shared, async |client: Client| {
        client.put(stage.bundle.clone()).await?;
        client.submit(Some("haze".into()), stage.spec.clone()).await
    })
    .await;
    let status: JobStatus = loop {
        let status = insist(&shared, async |client: Client| client.status(job).await).await;
        if status.state.has_ended() {
            break status;
        }
        tokio::time::sleep(LOOK).await;
    };
    let pixels = insist(&shared, async |client: Client| frames(&client, job).await).await;
    let pixels = pixels.into_iter().map(|(_, file)| stage::pixels(file)).collect::<anyhow::Result<_>>()?;
    shared.lock().end = Some((status, pixels));
    Ok(())
}

/// The files of a job's finished frames.
pub(crate) async fn frames(client: &Client, job: JobId) -> Result<Vec<(FrameRecord, bytes::Bytes)>, CallError> {
    let mut files = Vec::new();
    for frame in client.frames(job).await? {
        let file = client.get(&frame.image.digest, frame.image.bytes).await?;
        files.push((frame, file));
    }
    Ok(files)
}

/// Asks the coordinator that leads until it answers with something else than an error.
pub(crate) async fn insist<T>(shared: &Shared, ask: impl AsyncFn(Client) -> Result<T, CallError>) -> T {
    loop {
        match answer(shared, &ask).await {
            Ok(answer) => return answer,
            Err(refusal) => shared.note(|| format!("person: {refusal}")),
        }
        tokio::time::sleep(Duration::from_millis(300)).await;
    }
}

/// Asks the coordinator that leads until it answers, be it with a refusal.
pub(crate) async fn answer<T>(
    shared: &Shared,
    ask: &impl AsyncFn(Client) -> Result<T, CallError>,
) -> Result<T, Refusal> {
    loop {
        let leader = url(&coordinator_name(shared.lock().leader));
        let answer = tokio::time::timeout(Duration::from_secs(5), async {
            let client = Client::connect_by(&dial(shared, "person"), &leader).await?;
            ask(client).await
        });
        match answer.await {
            Ok(Ok(answer)) => return Ok(answer),
            Ok(Err(CallError::Refused(no @ (Refusal::Unavailable { .. } | Refusal::NoRoom { .. })))) => {
                shared.note(|| format!("person: {no}"));
            }
            Ok(Err(CallError::Refused(refusal))) => return Err(refusal),
            Ok(Err(error)) => shared.note(|| format!("person: {error}")),
            Err(_) => shared.note(|| "person: no answer".into()),
        }
        tokio::time::sleep(Duration::from_millis(300)).await;
    }
}
