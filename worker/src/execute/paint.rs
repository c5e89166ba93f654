//! The paint task: renders frames in a painted style, one after the other. Each frame continues the brushwork of the previous one.

use std::io::Cursor;

use femc_film::{FilmError, LuminanceLevels, Picture, ToneCurve};
use femc_model::{Failure, Phase, Role, StageTemplate};
use femc_stylize::{Brushwork, Example, GuideFrame, PreviousFrame, Settings, StylizeError, frames, styles};

use super::inputs::for_each_input;
use super::{Product, Tools, settings_failure};
use crate::clock::Stopwatch;
use crate::extra_outputs::ExtraOutputs;
use crate::task_table::Task;

/// Paints the task's frame under the exposure common to all frames. A missing frame gives a card, and the next frame is painted
/// from scratch.
pub(super) fn paint(task: &Task, stage: &StageTemplate, tools: &Tools) -> Result<Product, Failure> {
    let watch = Stopwatch::start();
    task.set_phase(Phase::Preparing);
    let outputs: ExtraOutputs = serde_json::from_str(&stage.options).map_err(settings_failure)?;
    let wanted = outputs.painting.filter(|painting| painting.is_valid());
    let wanted = wanted.ok_or_else(|| settings_failure("invalid job graph: a paint stage names no valid style"))?;
    let style =
        styles::painting(&wanted.style).ok_or_else(|| settings_failure("this worker does not know the paint style"))?;
    let (style, source) = (style.map_err(settings_failure)?, styles::source().map_err(settings_failure)?);
    task.set_phase(Phase::Working);
    let (mut curve, mut frame) = (ToneCurve::from_levels(&LuminanceLevels::default()), None);
    for_each_input(task, Role::Levels, tools, |bytes| {
        LuminanceLevels::decode(bytes).map(|levels| curve = ToneCurve::from_levels(&levels))
    })?;
    let size = task.spec.grid.film;
    for_each_input(task, Role::LayerImage, tools, |bytes| {
        let read = GuideFrame::decode(Cursor::new(bytes))?;
        if read.size() != size {
            return Err(FilmError::Corrupt("the layers and the job's film differ in size"));
        }
        frame = Some(read);
        Ok(())
    })?;
    let mut before: Option<PreviousFrame> = None;
    for_each_input(task, Role::Brushwork, tools, |bytes| {
        let damaged = |_: StylizeError| FilmError::Corrupt("brushwork");
        let moved = Brushwork::decode(bytes).map_err(damaged)?.reproject(&style);
        before = moved.transpose().map_err(damaged)?;
        Ok::<_, FilmError>(())
    })?;
    let mut product = Product::default();
    let (picture, brushwork) = match frame {
        None => (Picture::placeholder(size[0], size[1]), Brushwork::empty()),
        Some(frame) => {
            let settings = Settings { boil: wanted.boil, ..Settings::default() };
            let painted = tools.install(task, || {
                let names = frames::common_guides(&source, &frame)?;
                let guides = source.guides(&names, ToneCurve::auto(source.exposure_image().as_ref()))?;
                let shown = frame.guides(&names, curve)?;
                let example = Example { style: &style, guides: &guides };
                femc_stylize::stylize(example, &shown, before.as_ref(), &settings, None, &())
            });
            let painted = painted.map_err(|error| settings_failure(format!("cannot paint the frame: {error}")))?;
            let figures = painted.quality;
            tracing::debug!(guide_error = figures.guide_error, usage_entropy = figures.usage_entropy, "painted");
            (frames::image_to_picture(&painted.image), Brushwork::new(&painted.field, frame.motion(), frame.depth()))
        }
    };
    let png = tools.install(task, || picture.to_png()).map_err(|error| settings_failure(error.to_string()))?;
    product.put(stage, Role::Painted, || png);
    product.put(stage, Role::Brushwork, || tools.install(task, || brushwork.encode()));
    product.result.seconds = watch.seconds();
    Ok(product)
}
