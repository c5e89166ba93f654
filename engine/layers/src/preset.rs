//! Named presets of common layers.

use crate::error::LayerError;
use crate::layer::Layer;
use std::str::FromStr;

/// A named preset of layers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Preset {
    /// The five layers that guide stylization: all light, direct diffuse, direct specular, the first two diffuse bounces, diffuse
    /// interreflection.
    Guides,
    /// One layer per lamp or group of lamps: all of its light that reaches the camera.
    Lamps,
    /// Sources seen directly, and light that was scattered once.
    Direct,
    /// Light that was scattered twice or more.
    Indirect,
    /// Light that was scattered in a medium.
    Fog,
    /// Light that was not scattered in a medium.
    Surfaces,
}

impl Preset {
    /// Names of the presets, in order.
    pub const NAMES: [&str; 6] = ["guides", "lamps", "direct", "indirect", "fog", "surfaces"];
    const ALL: [Self; 6] = [Self::Guides, Self::Lamps, Self::Direct, Self::Indirect, Self::Fog, Self::Surfaces];

    /// Returns the name.
    pub fn name(self) -> &'static str {
        Self::NAMES[self as usize]
    }

    /// Returns the layers of the preset.
    /// - `lamps`: labels of the scene's lamps.
    pub fn layers<'a>(self, lamps: impl IntoIterator<Item = &'a str>) -> Result<Vec<Layer>, LayerError> {
        let one = |expression: &str| Ok(vec![Layer::new(self.name(), expression)]);
        match self {
            Self::Guides => Ok([
                ("full", "C.*"),
                ("direct_diffuse", "CD[LOB]"),
                ("direct_specular", "C[GS][LOB]"),
                ("two_diffuse", "CDD?[LOB]"),
                ("diffuse_interreflection", "CDD.*"),
            ]
            .map(|(name, expression)| Layer::new(name, expression))
            .into()),
            Self::Lamps => {
                let mut layers: Vec<Layer> = Vec::new();
                for lamp in lamps {
                    let quoted = lamp.replace('\\', r"\\").replace('\'', r"\'");
                    let expression = format!("C.*<[LOB].'{quoted}'>");
                    if layers.iter().all(|layer| layer.expression != expression) {
                        let name = lamp_layer_name(lamp, &layers);
                        layers.push(Layer { name, expression });
                    }
                }
                if layers.is_empty() { Err(LayerError::NoLamps) } else { Ok(layers) }
            }
            Self::Direct => one("C[RTV]?[LOB]"),
            Self::Indirect => one("C[RTV][RTV]+[LOB]"),
            Self::Fog => one("C.*V.*"),
            Self::Surfaces => one("C[^V]*"),
        }
    }
}

/// Returns a channel name for a lamp's layer that none of `others` has.
fn lamp_layer_name(lamp: &str, others: &[Layer]) -> String {
    let fit = |c: char| if c.is_ascii_alphanumeric() || c == '-' { c } else { '_' };
    let mut base: String = lamp.trim_matches('/').chars().map(fit).take(48).collect();
    if base.is_empty() {
        base = "lamp".into();
    }
    // The prefix keeps lamp layers apart from the other channels of the file.
    let base = format!("lamp_{base}");
    let is_free = |name: &String| others.iter().all(|layer| layer.name != *name);
    let numbered = (2..).map(|number| format!("{base}_{number}"));
    std::iter::once(base.clone()).chain(numbered).find(is_free).unwrap_or(base)
}

impl FromStr for Preset {
    type Err = LayerError;

    fn from_str(text: &str) -> Result<Self, LayerError> {
        let found = Self::NAMES.iter().position(|name| *name == text);
        found.map(|at| Self::ALL[at]).ok_or_else(|| LayerError::UnknownPreset(text.to_owned()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_preset_has_layers_that_can_be_read_and_names_itself() {
        for name in Preset::NAMES {
            let preset: Preset = name.parse().unwrap();
            assert_eq!(preset.name(), name);
            let layers = preset.layers(["room.lamp/bulb", "it's", "room_lamp/bulb", "it's"]).unwrap();
            assert!(!layers.is_empty());
            crate::parse_layers(&layers).unwrap();
        }
        let lamps = Preset::Lamps.layers(["a.b/c", "a_b/c", "a.b/c"]).unwrap();
        assert_eq!(lamps.iter().map(|it| it.name.as_str()).collect::<Vec<_>>(), ["lamp_a_b_c", "lamp_a_b_c_2"]);
        assert_eq!(Preset::Lamps.layers([]), Err(LayerError::NoLamps));
        assert!("lights".parse::<Preset>().is_err_and(|e| e.to_string().contains("guides, lamps")));
    }
}
