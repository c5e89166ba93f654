//! Comparisons of two pictures.

use bytes::Bytes;
use femc_model::{Digest, FrameRecord, JobId, Refusal};

use super::{Picture, PictureSource, Pictures};
use crate::call::Call;
use crate::farm::Farm;
use crate::job_control::MissingOutput;
use crate::light::{LightViewError, LightViews};

/// A picture to compare.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum ComparedPicture {
    /// Image of a finished frame.
    Frame(JobId, u32),
    /// Mean luminances of a file with light statistics, by its number.
    File(usize),
}

/// A picture that exists.
enum LocatedPicture {
    Image(Digest),
    File { number: usize, tag: String },
}

impl LocatedPicture {
    fn tag(&self) -> String {
        match self {
            Self::Image(digest) => digest.to_string(),
            Self::File { tag, .. } => tag.clone(),
        }
    }
}

impl Pictures {
    /// Compares two pictures; `None`: a frame is not finished, or has no image.
    /// - `known`: tag of the comparison that the client has. If it is current, nothing is compared and the bytes are empty.
    pub(crate) async fn compare<S>(
        &self,
        farm: &Farm<S>,
        views: &LightViews,
        [a, b]: [ComparedPicture; 2],
        known: Option<&str>,
    ) -> Result<Option<Picture>, LightViewError> {
        let unavailable = || Refusal::Unavailable { message: "this program cannot compare pictures".into() };
        let compare = self.compare.ok_or_else(unavailable)?;
        let Some(a) = locate(farm, views, a).await? else { return Ok(None) };
        let Some(b) = locate(farm, views, b).await? else { return Ok(None) };
        let tag = Digest::compute(format!("compare {} {}", a.tag(), b.tag()).as_bytes()).to_string();
        if known == Some(&tag) {
            return Ok(Some(Picture { tag, bytes: Bytes::new() }));
        }
        if let Some(kept) = self.cached_answer(&tag) {
            return Ok(Some(kept));
        }
        // The semaphore is never closed.
        let _turn = self.draw_permits.acquire().await;
        let Some(a) = self.read(farm, views, &a).await? else { return Ok(None) };
        let Some(b) = self.read(farm, views, &b).await? else { return Ok(None) };
        let compared = tokio::task::spawn_blocking(move || compare([a, b])).await;
        let compared = compared.map_err(|error| error.to_string()).and_then(|compared| compared);
        let bytes = compared.map_err(|message| LightViewError::Unreadable { message })?;
        let picture = Picture { tag, bytes: bytes.into() };
        self.cache_answer(picture.clone());
        Ok(Some(picture))
    }

    async fn read<S>(
        &self,
        farm: &Farm<S>,
        views: &LightViews,
        picture: &LocatedPicture,
    ) -> Result<Option<PictureSource>, LightViewError> {
        match picture {
            LocatedPicture::File { number, .. } => Ok(Some(PictureSource::Statistics(views.read_file(*number).await?))),
            LocatedPicture::Image(digest) => {
                let bytes = farm.read_output(&self.store, *digest, MissingOutput::Lost).await?;
                Ok(bytes.map(PictureSource::Image))
            }
        }
    }
}

async fn locate<S>(
    farm: &Farm<S>,
    views: &LightViews,
    picture: ComparedPicture,
) -> Result<Option<LocatedPicture>, LightViewError> {
    match picture {
        ComparedPicture::File(number) => Ok(Some(LocatedPicture::File { number, tag: views.file_tag(number).await? })),
        ComparedPicture::Frame(job, frame) => {
            let finished: Vec<FrameRecord> = farm.call(|reply| Call::Frames { job, reply }).await?;
            let image = finished.iter().find(|record| record.frame == frame).and_then(FrameRecord::image);
            Ok(image.map(|image| LocatedPicture::Image(image.digest)))
        }
    }
}
