//! Page about run time against error.

use super::logarithmic::{Chart, Line, Mark, draw};
use super::page::Page;
use crate::ReportError;
use crate::bench::method::Method;
use crate::bench::record::Record;
use crate::bench::statistics::Estimate;
use crate::bench::summary::{Point, SceneSummary, Summary};
use crate::bench::table;
use plotters::style::RGBColor;

/// Colors that color-blind people can distinguish (Okabe and Ito).
const COLORS: [RGBColor; 6] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(86, 180, 233),
    RGBColor(230, 159, 0),
];

/// Height of a large plot and of a small one, pixels.
const HEIGHTS: [u32; 2] = [440, 290];

/// Returns the HTML file.
pub fn page(record: &Record, summary: &Summary) -> Result<String, ReportError> {
    let names: Vec<&str> = summary.scenes.iter().map(|scene| &*scene.scene).collect();
    let mut page = Page::new(&format!("Run time against error: {}", names.join(", ")));
    page.facts(&table::facts(&record.setup, summary));
    let methods = table::methods(summary);
    if let Some(first) = summary.methods.first().filter(|_| !methods.1.is_empty()) {
        page.section(
            "All scenes",
            &format!(
                "Relative to {}: geometric means over scenes and over budgets in its measured range. An efficiency above 1 is better.",
                first.method
            ),
        );
        page.cells(&methods.0, &methods.1);
    }
    for scene in &summary.scenes {
        let setup = record.scenes.iter().find(|setup| setup.name == scene.scene);
        let about = setup.map_or_else(String::new, |setup| {
            let [width, height] = setup.film;
            format!(
                "{}, frame {}, {width}x{height} pixels; reference {}; scene {:.16}",
                setup.file, setup.frame, setup.reference, setup.digest
            )
        });
        page.section(&scene.scene, &about);
        page.legend(&legend(scene));
        let plots = |charts, height| draw(charts, HEIGHTS[height]);
        page.figures(
            &plots(vec![chart(scene, "relmse", |it| it.relmse)], 0)?,
            "No point has an error above the reference's noise.",
        );
        let small = vec![
            chart(scene, "worst block", |it| it.worst),
            chart(scene, "mse, (cd/m2)^2", |it| it.mse),
            chart(scene, "flip", |it| it.flip),
        ];
        page.figures(&plots(small, 1)?, "");
        table::notes(scene).iter().for_each(|note| page.text(note));
        let (titles, rows) = table::points(scene);
        page.cells(&titles, &rows);
    }
    page.section(
        "How to read this",
        "Lower and further left is better. Each point is the mean over the seeds for one method and one budget; the band is its 95 % \
         confidence interval. A method that only draws more samples follows a line of slope -1, on which 1/(relmse s) is constant. \
         \"Time at equal relmse\" is the method's time divided by the time that the first method needs for the same relmse, \
         interpolated between its budgets on straight lines of this plot. The worst block of 16x16 pixels has the largest relative \
         error of its mean luminance; `--error` limits this error.",
    );
    Ok(page.finish())
}

fn legend(scene: &SceneSummary) -> Vec<(&'static str, RGBColor)> {
    scene.methods.iter().map(|it| it.method).zip(COLORS.into_iter().cycle()).collect()
}

/// Plots a quantity of all points against seconds.
fn chart(scene: &SceneSummary, name: &'static str, quantity: fn(&Point) -> Estimate) -> Chart {
    let line = |(method, color): (&'static str, RGBColor)| {
        let mut marks: Vec<Mark> = scene
            .points
            .iter()
            .filter(|point| point.method == method)
            .map(|point| mark(point, quantity(point)))
            .collect();
        marks.sort_by(|a, b| a.position.0.total_cmp(&b.position.0));
        Line { color, marks }
    };
    Chart { axes: ["seconds", name], lines: legend(scene).into_iter().map(line).collect() }
}

fn mark(point: &Point, error: Estimate) -> Mark {
    let budget = Method::from_name(point.method).map_or_else(|_| String::new(), |it| it.format_budget(point.budget));
    Mark {
        position: (point.seconds.mean, error.mean),
        half_width: error.half_width,
        title: format!(
            "{}, {budget}: {} in {} s, {} samples per pixel",
            point.method,
            table::format_estimate(error),
            table::format_estimate(point.seconds),
            table::three_digits(point.spp)
        ),
    }
}
