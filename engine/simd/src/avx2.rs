//! The AVX2 instruction set: one register per vector, no fused multiply-add.

use super::{Integers, Kernel, Lanes, Simd, Vector, WIDTH, sealed::Sealed};
use std::{
    arch::x86_64::*,
    mem::MaybeUninit,
    ops::{Add, BitAnd, BitOr, BitXor, Div, Mul, Sub},
};

/// Token that proves that the processor has AVX2 and the bit instructions that come with it.
#[derive(Clone, Copy, Debug)]
pub struct Token(());

#[derive(Clone, Copy)]
pub struct Floats(__m256);

#[derive(Clone, Copy)]
pub struct Whole(__m256i);

/// Table of lane numbers: entry `m` lists the set bits of `m`, one lane number per byte.
static COMPRESS: [u64; 256] = {
    let mut table = [0; 256];
    let mut mask = 0;
    while mask < 256 {
        let (mut lane, mut place) = (0, 0);
        while lane < 8 {
            if mask >> lane & 1 == 1 {
                table[mask] |= (lane as u64) << (8 * place);
                place += 1;
            }
            lane += 1;
        }
        mask += 1;
    }
    table
};

impl Token {
    pub fn detect() -> Option<Self> {
        let all = is_x86_feature_detected!("avx2")
            && is_x86_feature_detected!("bmi1")
            && is_x86_feature_detected!("bmi2")
            && is_x86_feature_detected!("popcnt")
            && is_x86_feature_detected!("lzcnt");
        all.then_some(Self(()))
    }

    #[inline(always)]
    pub fn run<T: Kernel>(self, kernel: T) -> T::Output {
        #[target_feature(enable = "avx2,bmi1,bmi2,popcnt,lzcnt")]
        fn run<T: Kernel>(token: Token, kernel: T) -> T::Output {
            kernel.run(token)
        }
        // SAFETY: a token exists only if `detect` has found these features.
        unsafe { run(self, kernel) }
    }
}

macro_rules! operators {
    ($($trait:ident $method:ident $intrinsic:ident;)*) => {$(
        impl $trait for Floats {
            type Output = Self;
            #[inline(always)]
            fn $method(self, other: Self) -> Self {
                // SAFETY: a vector can only be made from a token, which proves AVX2.
                Self(unsafe { $intrinsic(self.0, other.0) })
            }
        }
    )*};
}

operators! {
    Add add _mm256_add_ps;
    Sub sub _mm256_sub_ps;
    Mul mul _mm256_mul_ps;
    Div div _mm256_div_ps;
    BitAnd bitand _mm256_and_ps;
    BitOr bitor _mm256_or_ps;
    BitXor bitxor _mm256_xor_ps;
}

macro_rules! methods {
    ($($method:ident $intrinsic:ident $(::<$comparison:ident>)?;)*) => {$(
        #[inline(always)]
        fn $method(self, other: Self) -> Self {
            // SAFETY: a vector can only be made from a token, which proves AVX2.
            Self(unsafe { $intrinsic$(::<$comparison>)?(self.0, other.0) })
        }
    )*};
}

impl Vector for Floats {
    methods! {
        min _mm256_min_ps;
        max _mm256_max_ps;
        le _mm256_cmp_ps::<_CMP_LE_OQ>;
        lt _mm256_cmp_ps::<_CMP_LT_OQ>;
        equal _mm256_cmp_ps::<_CMP_EQ_OQ>;
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        // SAFETY: a vector can only be made from a token, which proves AVX2.
        Self(unsafe { _mm256_sqrt_ps(self.0) })
    }
    #[inline(always)]
    fn select(self, yes: Self, no: Self) -> Self {
        // SAFETY: a vector can only be made from a token, which proves AVX2.
        Self(unsafe { _mm256_blendv_ps(no.0, yes.0, self.0) })
    }
    #[inline(always)]
    fn signs(self) -> u32 {
        // SAFETY: a vector can only be made from a token, which proves AVX2.
        unsafe { _mm256_movemask_ps(self.0) as u32 }
    }
    #[inline(always)]
    fn lanes(self) -> Lanes {
        let mut lanes = Lanes([0.0; WIDTH]);
        // SAFETY: as above; `Lanes` holds eight floats and is aligned to 32 bytes.
        unsafe { _mm256_store_ps(lanes.0.as_mut_ptr(), self.0) };
        lanes
    }
}

macro_rules! integer_methods {
    ($($method:ident $intrinsic:ident;)*) => {$(
        #[inline(always)]
        fn $method(self, other: Self) -> Self {
            // SAFETY: a vector can only be made from a token, which proves AVX2.
            Self(unsafe { $intrinsic(self.0, other.0) })
        }
    )*};
}

impl Integers for Whole {
    integer_methods! {
        plus _mm256_add_epi32;
        times _mm256_mullo_epi32;
        and _mm256_and_si256;
        or _mm256_or_si256;
        xor _mm256_xor_si256;
    }
    #[inline(always)]
    fn constant(self, value: u32) -> Self {
        // SAFETY: a vector can only be made from a token, which proves AVX2.
        Self(unsafe { _mm256_set1_epi32(value.cast_signed()) })
    }
    #[inline(always)]
    fn shifted_up<const BITS: i32>(self) -> Self {
        // SAFETY: a vector can only be made from a token, which proves AVX2.
        Self(unsafe { _mm256_slli_epi32::<BITS>(self.0) })
    }
    #[inline(always)]
    fn shifted_down<const BITS: i32>(self) -> Self {
        // SAFETY: a vector can only be made from a token, which proves AVX2.
        Self(unsafe { _mm256_srli_epi32::<BITS>(self.0) })
    }
    #[inline(always)]
    fn reversed(self) -> Self {
        // SAFETY: a vector can only be made from a token, which proves AVX2.
        unsafe {
            let nibble = _mm256_set1_epi8(15);
            // Bits of a nibble in reverse order, and the same in the upper half of a byte.
            let low = _mm256_setr_epi8(
                0, 8, 4, 12, 2, 10, 6, 14, 1, 9, 5, 13, 3, 11, 7, 15, 0, 8, 4, 12, 2, 10, 6, 14, 1, 9, 5, 13, 3, 11, 7,
                15,
            );
            let high = _mm256_slli_epi32::<4>(low);
            let upper = _mm256_and_si256(_mm256_srli_epi32::<4>(self.0), nibble);
            let bytes = _mm256_or_si256(
                _mm256_shuffle_epi8(high, _mm256_and_si256(self.0, nibble)),
                _mm256_shuffle_epi8(low, upper),
            );
            let order = _mm256_setr_epi8(
                3, 2, 1, 0, 7, 6, 5, 4, 11, 10, 9, 8, 15, 14, 13, 12, 3, 2, 1, 0, 7, 6, 5, 4, 11, 10, 9, 8, 15, 14, 13,
                12,
            );
            Self(_mm256_shuffle_epi8(bytes, order))
        }
    }
}

impl Sealed for Token {}

impl Simd for Token {
    type V = Floats;
    type I = Whole;
    #[inline(always)]
    fn integers(self, lanes: &[u32; WIDTH]) -> Whole {
        // SAFETY: the token proves AVX2; `lanes` holds eight u32.
        Whole(unsafe { _mm256_loadu_si256(lanes.as_ptr().cast()) })
    }
    #[inline(always)]
    fn to_floats(self, integers: Whole) -> Floats {
        // SAFETY: the token proves AVX2.
        Floats(unsafe { _mm256_cvtepi32_ps(integers.0) })
    }
    #[inline(always)]
    fn bits(self, floats: Floats) -> Whole {
        // SAFETY: the token proves AVX2.
        Whole(unsafe { _mm256_castps_si256(floats.0) })
    }
    #[inline(always)]
    fn with_bits(self, bits: Whole) -> Floats {
        // SAFETY: the token proves AVX2.
        Floats(unsafe { _mm256_castsi256_ps(bits.0) })
    }
    #[inline(always)]
    fn splat(self, x: f32) -> Floats {
        // SAFETY: the token proves AVX2.
        Floats(unsafe { _mm256_set1_ps(x) })
    }
    #[inline(always)]
    fn mask(self, bits: u32) -> Floats {
        // SAFETY: the token proves AVX2.
        unsafe {
            let lane_bits = _mm256_setr_epi32(1, 2, 4, 8, 16, 32, 64, 128);
            let set = _mm256_and_si256(_mm256_set1_epi32(bits.cast_signed()), lane_bits);
            Floats(_mm256_castsi256_ps(_mm256_cmpeq_epi32(set, lane_bits)))
        }
    }
    #[inline(always)]
    fn load(self, lanes: &Lanes) -> Floats {
        // SAFETY: the token proves AVX2; `Lanes` holds eight floats and is aligned to 32 bytes.
        Floats(unsafe { _mm256_load_ps(lanes.0.as_ptr()) })
    }
    #[inline(always)]
    fn compress(self, mask: u32, high: Floats, low: &[u32; WIDTH], room: &mut [MaybeUninit<u64>; WIDTH]) -> usize {
        let mask = mask & 255;
        let room = room.as_mut_ptr().cast::<__m256i>();
        // SAFETY: the token proves AVX2. `low` holds eight u32; `room` holds eight u64 and is fully written.
        unsafe {
            let places = _mm256_cvtepu8_epi32(_mm_cvtsi64_si128(COMPRESS[mask as usize] as i64));
            let low = _mm256_loadu_si256(low.as_ptr().cast());
            let low = _mm256_permutevar8x32_epi32(low, places);
            let high = _mm256_permutevar8x32_epi32(_mm256_castps_si256(high.0), places);
            let even = _mm256_unpacklo_epi32(low, high);
            let odd = _mm256_unpackhi_epi32(low, high);
            _mm256_storeu_si256(room, _mm256_permute2x128_si256::<0x20>(even, odd));
            _mm256_storeu_si256(room.add(1), _mm256_permute2x128_si256::<0x31>(even, odd));
        }
        mask.count_ones() as usize
    }
}
