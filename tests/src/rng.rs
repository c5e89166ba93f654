/// A small generator (SplitMix64), so that a finding is its seed.
#[derive(Debug, Clone)]
pub struct Rng(u64);

impl Rng {
    /// Of this seed.
    pub fn new(seed: u64) -> Self {
        Self(seed)
    }

    /// The next 64 bits.
    pub fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// In `0..n`; 0 for an empty range.
    pub fn below(&mut self, n: usize) -> usize {
        (self.bits() % n.max(1) as u64) as usize
    }

    /// One of them.
    /// - panics: if there is none.
    pub fn pick<'a, T>(&mut self, all: &'a [T]) -> &'a T {
        &all[self.below(all.len())]
    }

    /// Once in so many times.
    pub fn once_in(&mut self, n: usize) -> bool {
        self.below(n) == 0
    }

    /// Small, large, and where things overflow.
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
