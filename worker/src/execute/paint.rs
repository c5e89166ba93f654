//! The paint task: renders frames in a painted style, one after the other. Each frame continues the brushwork of the previous one.

use std::io::Cursor;

use femc_film::{FilmError, Levels, Picture, ToneCurve};
use femc_model::{Failure, Phase, Role, Template};
use femc_stylize::{Before, Brushwork, Example, GuideFrame, Settings, StylizeError, frames, styles};

use super::encode::Wish;
use super::union::each;
use super::{Product, Tools, unfit};
use crate::clock::Stopwatch;
use crate::table::Task;

/// Paints the task's frame under the exposure common to all frames. A missing frame gives a card, and the next frame is painted
/// from scratch.
pub(super) fn paint(task: &Task, stage: &Template, tools: &Tools) -> Result<Product, Failure> {
    let watch = Stopwatch::start();
    task.enter(Phase::Preparing);
    let wish: Wish = serde_json::from_str(&stage.options).map_err(unfit)?;
    let wanted = wish.painting.filter(|painting| painting.is_sound());
    let wanted = wanted.ok_or_else(|| unfit("invalid job graph: a paint stage names no valid style"))?;
    let style = styles::painting(&wanted.style).ok_or_else(|| unfit("this worker does not know the paint style"))?;
    let (style, source) = (style.map_err(unfit)?, styles::source().map_err(unfit)?);
    task.enter(Phase::Working);
    let (mut curve, mut frame) = (ToneCurve::of_levels(&Levels::default()), None);
    each(task, Role::Levels, tools, |bytes| Levels::decode(bytes).map(|levels| curve = ToneCurve::of_levels(&levels)))?;
    let size = task.spec.grid.film;
    each(task, Role::LayerImage, tools, |bytes| {
        let read = GuideFrame::decode(Cursor::new(bytes))?;
        if read.size() != size {
            return Err(FilmError::Corrupt("the layers and the job's film differ in size"));
        }
        frame = Some(read);
        Ok(())
    })?;
    let mut before: Option<Before> = None;
    each(task, Role::Brushwork, tools, |bytes| {
        let damaged = |_: StylizeError| FilmError::Corrupt("brushwork");
        let moved = Brushwork::decode(bytes).map_err(damaged)?.before(&style);
        before = moved.transpose().map_err(damaged)?;
        Ok::<_, FilmError>(())
    })?;
    let mut product = Product::default();
    let (picture, brushwork) = match frame {
        None => (Picture::missing(size[0], size[1]), Brushwork::of_nothing()),
        Some(frame) => {
            let settings = Settings { boil: wanted.boil, ..Settings::default() };
            let painted = tools.install(task, || {
                let names = frames::common(&source, &frame)?;
                let guides = source.guides(&names, ToneCurve::auto(source.exposed().as_ref()))?;
                let shown = frame.guides(&names, curve)?;
                let example = Example { style: &style, guides: &guides };
                femc_stylize::stylize(example, &shown, before.as_ref(), &settings, None, &())
            });
            let painted = painted.map_err(|error| unfit(format!("cannot paint the frame: {error}")))?;
            let figures = painted.figures;
            tracing::debug!(guide_error = figures.guide_error, usage_entropy = figures.usage_entropy, "painted");
            (frames::picture(&painted.image), Brushwork::new(&painted.field, frame.motion(), frame.depth()))
        }
    };
    let png = tools.install(task, || picture.to_png()).map_err(|error| unfit(error.to_string()))?;
    product.put(stage, Role::Painted, || png);
    product.put(stage, Role::Brushwork, || tools.install(task, || brushwork.encode()));
    product.result.seconds = watch.seconds();
    Ok(product)
}
