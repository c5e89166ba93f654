/// A small random number generator (SplitMix64). A seed reproduces a finding.
#[derive(Debug, Clone)]
pub struct Rng(u64);

impl Rng {
    /// Creates a generator with this seed.
    pub fn new(seed: u64) -> Self {
        Self(seed)
    }

    /// Returns the next 64 bits.
    pub fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// Draws a number in `0..n`; 0 for an empty range.
    pub fn below(&mut self, n: usize) -> usize {
        (self.bits() % n.max(1) as u64) as usize
    }

    /// Draws an item.
    /// - panics: if there are no items.
    pub fn pick<'a, T>(&mut self, all: &'a [T]) -> &'a T {
        &all[self.below(all.len())]
    }

    /// Returns true with probability 1 / `n`.
    pub fn once_in(&mut self, n: usize) -> bool {
        self.below(n) == 0
    }

    /// Draws a small number, a large one, or one where arithmetic overflows.
    pub fn number(&mut self) -> u64 {
        match self.below(5) {
            0 => self.below(8) as u64,
            1 => self.bits() >> self.below(64),
            2 => u64::MAX >> self.below(64),
            3 => (1 << self.below(64)) - 1,
            _ => 1 << self.below(64),
        }
    }
}
