//! Outputs of a task: layers of the light, first-hit features and light statistics, in addition to the tile.

use crate::layers::{FeaturePlan, FeatureRecorder, LayerPlan, LayerRecorder};
use crate::render::{RenderError, RenderTask, RenderedTile};
use crate::statistics::{StatisticsPlan, StatisticsRecording};
use femc_montecarlo::Recorder;
use femc_montecarlo::record::RecorderPair;

/// Outputs in addition to the tile. The default is none.
#[derive(Clone, Copy, Debug, Default)]
pub struct Outputs<'a> {
    /// Layers of the light.
    pub layers: Option<&'a LayerPlan>,
    /// Features (AOVs) of the first visible surface.
    pub features: Option<&'a FeaturePlan>,
    /// Light statistics.
    pub statistics: Option<&'a StatisticsPlan>,
}

impl RenderTask<'_> {
    /// Renders the samples on the calling thread's rayon pool. The tile has the same bits with any outputs.
    /// - errors: cancelled, or pixels or samples exceed the film's limits.
    pub fn render(&self, outputs: Outputs<'_>) -> Result<RenderedTile, RenderError> {
        let of_light = |plan| move || LayerRecorder::new(plan, self.prepared);
        let of_features = |plan| move || FeatureRecorder::new(plan, self.prepared);
        match (outputs.layers, outputs.features) {
            (None, None) => Ok(self.render_recorded(outputs.statistics, || ())?.0),
            (Some(layers), None) => {
                let (mut rendered, recorders) = self.render_recorded(outputs.statistics, of_light(layers))?;
                rendered.aovs.light = Some(layers.tile(self, recorders)?);
                Ok(rendered)
            }
            (None, Some(features)) => {
                let (mut rendered, recorders) = self.render_recorded(outputs.statistics, of_features(features))?;
                rendered.aovs.features = Some(features.tile(self, recorders)?);
                Ok(rendered)
            }
            (Some(layers), Some(features)) => {
                let (of_light, of_features) = (of_light(layers), of_features(features));
                let both = || RecorderPair::new(of_light(), of_features());
                let (mut rendered, both) = self.render_recorded(outputs.statistics, both)?;
                let (first, second) = both.into_iter().map(|both| (both.first, both.second)).unzip();
                rendered.aovs.light = Some(layers.tile(self, first)?);
                rendered.aovs.features = Some(features.tile(self, second)?);
                Ok(rendered)
            }
        }
    }

    /// Renders the samples with statistics, if requested, and with recorders of another kind. Returns these in order, too.
    fn render_recorded<R: Recorder + Send>(
        &self,
        statistics: Option<&StatisticsPlan>,
        recorder: impl Fn() -> R + Sync,
    ) -> Result<(RenderedTile, Vec<R>), RenderError> {
        let Some(plan) = statistics else { return self.render_rows(recorder) };
        let recording = StatisticsRecording::new(self, plan);
        let (mut rendered, both) = self.render_rows(|| RecorderPair::new(recording.recorder(), recorder()))?;
        let (recorded, others) = both.into_iter().map(|both| (both.first.recorded, both.second)).unzip();
        rendered.statistics = Some(recording.finish(recorded));
        Ok((rendered, others))
    }
}
