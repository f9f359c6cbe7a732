//! The frame of the observing agent, and rows of any columns in it, eight numbers at a time.

use super::column::{Axis, ObservationColumn, clip};
use crate::geom::{Pose2, Real};
use crate::simd_dispatch::simd_dispatch;

/// Columns that are written at once.
pub(super) const LANES: usize = 8;

/// The numbers of all lanes.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[repr(align(32))]
pub(super) struct F32x8(pub(super) [Real; LANES]);

/// The frame of an observing agent.
#[derive(Debug, Clone, Copy)]
pub(super) struct Frame {
    pub(super) x: Real,
    pub(super) y: Real,
    cos: Real,
    sin: Real,
}

impl Frame {
    pub(super) fn new(pose: &Pose2) -> Self {
        Self { x: pose.position.x, y: pose.position.y, cos: pose.cos, sin: pose.sin }
    }

    /// Two vectors (x₀, y₀, x₁, y₁) in this frame, each number times its factor and clipped to [−1, 1].
    #[inline(always)]
    pub(super) fn rotate(&self, [x0, y0, x1, y1]: [Real; 4], factor: [Real; 4]) -> [Real; 4] {
        let (v, w) = ([x0, y0, x1, y1], [y0, x0, y1, x1]);
        let sin = [self.sin, -self.sin, self.sin, -self.sin];
        // in the order of [`RowTransform::portable`], for the same bits
        std::array::from_fn(|i| clip(v[i] * (self.cos * factor[i]) + w[i] * (sin[i] * factor[i]), -1.0, 1.0))
    }
}

/// What a column of a row is made from.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Part {
    /// A component of one of the vectors of an item, by the place of the vector's x among the numbers of an origin.
    Component(usize, Axis),
    /// A number that is the same in every frame, in its scale.
    Constant,
}

impl Part {
    /// The other component of a vector; itself for what is none.
    fn other(self) -> Self {
        match self {
            Self::Component(vector, axis) => {
                Self::Component(vector, axis.own_and_other([Axis::X, Axis::Y]).1)
            }
            Self::Constant => self,
        }
    }
}

/// Up to eight columns that are made at once from as many numbers of an item, lane by lane, in the frame of any observer:
/// clip((own − its origin) · cos + (other − its origin) · sin, low, high), where `other` is the other component of a vector.
/// In lanes that are left are components that are not among the columns.
#[derive(Debug, Clone)]
pub(super) struct Group {
    /// What is in the lanes.
    pub(super) parts: Vec<Part>,
    pub(super) num_columns: usize,
    /// Where a lane's number is among those of an origin, and the lane of the other component.
    own: [usize; LANES],
    other: [i32; LANES],
    /// All bits for components of vectors, none for numbers that are the same in every frame.
    rotated: [u32; LANES],
    /// The bit of the sign where the sine is taken negative.
    sign: [u32; LANES],
    factor: [Real; LANES],
    low: F32x8,
    high: F32x8,
}

/// A [`Group`] in the frame of one observer.
#[derive(Debug, Clone, Copy)]
struct RowTransform {
    other: [i32; LANES],
    cos: F32x8,
    sin: F32x8,
    low: F32x8,
    high: F32x8,
    origin: F32x8,
}

/// Most groups of a row.
pub(super) const MOST_GROUPS: usize = 4;
/// A place among the numbers of an origin that is zero.
const ZERO: usize = 7;
const SIGN: u32 = 1 << 31;

impl Group {
    /// The groups of a row of columns.
    pub(super) fn of_row(columns: &[(Part, &ObservationColumn)]) -> Vec<Self> {
        let (mut groups, mut rest) = (Vec::new(), columns);
        while !rest.is_empty() {
            // a component and the other one fit always
            let fits = |n: &usize| Self::lanes(&rest[..*n]).len() <= LANES;
            let (chosen, others) = rest.split_at((1..=rest.len()).rev().find(fits).unwrap_or(1));
            groups.push(Self::new(chosen));
            rest = others;
        }
        groups
    }

    /// Columns, and the other components of their vectors where these are not among them.
    fn lanes(columns: &[(Part, &ObservationColumn)]) -> Vec<Part> {
        let mut lanes: Vec<Part> = columns.iter().map(|(part, _)| *part).collect();
        for lane in 0..lanes.len() {
            let other = lanes[lane].other();
            if !lanes.contains(&other) {
                lanes.push(other);
            }
        }
        lanes
    }

    fn new(columns: &[(Part, &ObservationColumn)]) -> Self {
        let parts = Self::lanes(columns);
        let (zero, none) = (F32x8([0.0; LANES]), [0; LANES]);
        let (own, other) = ([ZERO; LANES], std::array::from_fn(|lane| lane as i32));
        let (sign, factor, num_columns) = (none, [0.0; LANES], columns.len());
        let mut group =
            Self { parts, num_columns, own, other, rotated: none, sign, factor, low: zero, high: zero };
        for (lane, part) in group.parts.iter().enumerate() {
            if let Part::Component(vector, axis) = *part {
                group.own[lane] = axis.own_and_other([vector, vector + 1]).0;
                let other = group.parts.iter().position(|p| *p == part.other());
                group.other[lane] = other.unwrap_or(lane) as i32;
                group.rotated[lane] = u32::MAX;
            }
            // a number and the zero of its sign add up to its bits
            group.sign[lane] = if matches!(part, Part::Component(_, Axis::Y)) { SIGN } else { 0 };
            // what is not among the columns is left zero
            let Some((_, column)) = columns.get(lane) else { continue };
            group.factor[lane] = if *part == Part::Constant { 1.0 } else { 1.0 / column.scale };
            (group.low.0[lane], group.high.0[lane]) = (column.low, column.high);
        }
        group
    }

    /// Whether a lane is a component of a vector.
    pub(super) fn turns(&self) -> bool {
        self.rotated != [0; LANES]
    }

    #[inline(always)]
    fn in_frame(&self, frame: &Frame, origin: &F32x8) -> RowTransform {
        let [cos, sin, one] = [frame.cos, frame.sin, 1.0].map(Real::to_bits);
        let cos = |i: usize| Real::from_bits(cos & self.rotated[i] | one & !self.rotated[i]) * self.factor[i];
        let sin = |i: usize| Real::from_bits(sin & self.rotated[i] ^ self.sign[i]) * self.factor[i];
        RowTransform {
            other: self.other,
            cos: F32x8(std::array::from_fn(cos)),
            sin: F32x8(std::array::from_fn(sin)),
            low: self.low,
            high: self.high,
            origin: F32x8(self.own.map(|own| origin.0[own % LANES])),
        }
    }
}

impl RowTransform {
    /// The columns of an item.
    #[inline(always)]
    fn portable(&self, numbers: &F32x8) -> [Real; LANES] {
        let v: [Real; LANES] = std::array::from_fn(|i| numbers.0[i] - self.origin.0[i]);
        std::array::from_fn(|i| {
            let sum = v[i] * self.cos.0[i] + v[self.other[i] as usize % LANES] * self.sin.0[i];
            clip(sum, self.low.0[i], self.high.0[i])
        })
    }

    /// [`Self::portable`] in one vector.
    #[cfg(target_arch = "x86_64")]
    #[inline]
    #[target_feature(enable = "avx2")]
    #[allow(unsafe_code, reason = "arrays and vectors of the same numbers are the same bytes")]
    fn avx2(&self, numbers: &F32x8) -> [Real; LANES] {
        use std::arch::x86_64::*;
        // SAFETY: eight floats each
        let [numbers, origin, cos]: [__m256; 3] =
            unsafe { std::mem::transmute([*numbers, self.origin, self.cos]) };
        // SAFETY: as above
        let [sin, low, high]: [__m256; 3] = unsafe { std::mem::transmute([self.sin, self.low, self.high]) };
        // SAFETY: eight numbers of 32 bits
        let other: __m256i = unsafe { std::mem::transmute(self.other) };
        let v = _mm256_sub_ps(numbers, origin);
        let w = _mm256_permutevar8x32_ps(v, other);
        let sum = _mm256_add_ps(_mm256_mul_ps(v, cos), _mm256_mul_ps(w, sin));
        // SAFETY: eight floats
        unsafe { std::mem::transmute(_mm256_min_ps(_mm256_max_ps(sum, low), high)) }
    }
}

/// Fills the columns of groups in the rows of items, `width` numbers from row to row. `numbers` [N, groups] are those of all
/// items, lane by lane, `origin` the vectors of the observer.
/// Later columns of a row are overwritten.
pub(super) fn fill_rows(
    groups: &[Group],
    frame: &Frame,
    origin: &F32x8,
    numbers: &[F32x8],
    items: &[u32],
    width: usize,
    out: &mut [Real],
) {
    match groups {
        [a] => fill::<1>(&[a], frame, origin, numbers, items, width, out),
        [a, b] => fill::<2>(&[a, b], frame, origin, numbers, items, width, out),
        [a, b, c] => fill::<3>(&[a, b, c], frame, origin, numbers, items, width, out),
        [a, b, c, d] => fill::<4>(&[a, b, c, d], frame, origin, numbers, items, width, out),
        _ => debug_assert!(groups.is_empty()),
    }
}

/// Puts `G` times eight numbers for each index, `width` apart, as far as the output reaches.
#[inline(always)]
fn put_each<const G: usize>(
    indices: &[u32],
    firsts: &[usize; G],
    width: usize,
    out: &mut [Real],
    row: impl Fn(u32, usize) -> [Real; LANES],
) {
    let span = firsts.last().map_or(0, |first| first + LANES).min(G * LANES);
    let room = span.min(width);
    let num_whole = out.len().checked_sub(span).map_or(0, |most| most / width.max(1) + 1);
    let num_whole = num_whole.min(indices.len());
    let put = |to: &mut [Real], index: u32| {
        for (g, first) in firsts.iter().enumerate() {
            if let Some(to) = to.get_mut(*first..).and_then(|to| to.first_chunk_mut::<LANES>()) {
                *to = row(index, g);
            }
        }
    };
    let (fours, _) = indices[..num_whole].as_chunks::<4>();
    for (four, indices) in fours.iter().enumerate() {
        for (k, index) in indices.iter().enumerate() {
            let at = (4 * four + k) * width;
            #[allow(unsafe_code, reason = "a check for each row costs as much as the row")]
            // SAFETY: 4 · four + k < num_whole, so at + span <= out.len()
            put(unsafe { out.get_unchecked_mut(at..at + span) }, *index);
        }
    }
    for (k, index) in indices.iter().enumerate().skip(4 * fours.len()) {
        let at = k * width;
        let mut apart = [[0.0; LANES]; G];
        let is_whole = k < num_whole;
        put(if is_whole { &mut out[at..at + span] } else { &mut apart.as_flattened_mut()[..span] }, *index);
        if !is_whole && let Some(to) = out.get_mut(at..at + room) {
            to.iter_mut().zip(apart.as_flattened()).for_each(|(to, from)| *to = *from);
        }
    }
}

/// Eight of an item's numbers, each by its place.
#[inline(always)]
fn pick(places: &[i32; LANES], item: &F32x8) -> [Real; LANES] {
    places.map(|at| item.0[at as usize % LANES])
}

/// [`pick`] in one vector.
#[cfg(target_arch = "x86_64")]
#[inline]
#[target_feature(enable = "avx2")]
#[allow(unsafe_code, reason = "arrays and vectors of the same numbers are the same bytes")]
fn pick_avx2(places: &[i32; LANES], item: &F32x8) -> [Real; LANES] {
    use std::arch::x86_64::*;
    // SAFETY: eight numbers of 32 bits
    let places: __m256i = unsafe { std::mem::transmute(*places) };
    // SAFETY: eight floats
    let item: __m256 = unsafe { std::mem::transmute(*item) };
    // SAFETY: eight floats
    unsafe { std::mem::transmute(_mm256_permutevar8x32_ps(item, places)) }
}

simd_dispatch! {
    /// Puts numbers of some items by their places, where a mask has all bits, into a group of the numbers [N, groups].
    pub(super) fn spread(
        places: &[i32; LANES], mask: &[u32; LANES], items: &[F32x8], which: &[u32], group: usize, groups: usize,
        numbers: &mut [F32x8],
    ) with pick [Fn(&[i32; LANES], &F32x8) -> [Real; LANES]] = pick, pick_avx2 {
        for item in which {
            let item = *item as usize;
            let (picked, numbers) = (pick(places, &items[item]), &mut numbers[item * groups + group]);
            numbers.0 = std::array::from_fn(|lane| {
                Real::from_bits(picked[lane].to_bits() & mask[lane] | numbers.0[lane].to_bits() & !mask[lane])
            });
        }
    }

    /// [`fill_rows`] of `G` groups.
    fn fill<G>(
        groups: &[&Group; G], frame: &Frame, origin: &F32x8, numbers: &[F32x8], items: &[u32], width: usize, out: &mut [Real],
    ) with transform [Fn(&RowTransform, &F32x8) -> [Real; LANES]] = RowTransform::portable, RowTransform::avx2 {
        let transforms = groups.map(|group| group.in_frame(frame, origin));
        let turns = groups.map(Group::turns);
        let mut first = 0;
        let firsts = groups.map(|group| {
            first += group.num_columns;
            first - group.num_columns
        });
        let numbers = numbers.as_chunks::<G>().0;
        put_each::<G>(items, &firsts, width, out, |item, g| {
            let numbers = &numbers[item as usize][g];
            if turns[g] { transform(&transforms[g], numbers) } else { numbers.0 }
        });
    }
}

#[cfg(test)]
#[cfg(target_arch = "x86_64")]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        #[allow(unsafe_code, reason = "the function is called where the processor has the instructions")]
        fn both_ways_to_turn_a_row_give_the_same_bits(
            item in prop::array::uniform8(-500f32..500.0), pose in prop::array::uniform3(-300f32..300.0),
            scale in prop::array::uniform8(1f32..100.0), at in prop::array::uniform8(0usize..7),
        ) {
            let frame = Frame::new(&Pose2::new(pose[0], pose[1], pose[2]));
            let column = |lane: usize| ObservationColumn {
                name: "", unit: "", scale: scale[lane], low: -1.0, high: 1.0, doc: "", in_default: true,
            };
            let columns: [ObservationColumn; LANES] = std::array::from_fn(column);
            let part = |lane: usize| match at[lane] {
                6 => Part::Constant,
                at => Part::Component(at / 2 * 2, if at % 2 == 0 { Axis::X } else { Axis::Y }),
            };
            let row: Vec<_> = columns.iter().enumerate().map(|(lane, column)| (part(lane), column)).collect();
            let group = &Group::of_row(&row)[0];
            let transform = group.in_frame(&frame, &F32x8([frame.x, frame.y, 0.0, 0.0, 1.5, -1.5, 0.0, 0.0]));
            if std::arch::is_x86_feature_detected!("avx2") {
                // SAFETY: just asked
                let wide = unsafe { transform.avx2(&F32x8(item)) };
                let portable = transform.portable(&F32x8(item));
                prop_assert_eq!(wide.map(Real::to_bits), portable.map(Real::to_bits));
            }
        }
    }
}
