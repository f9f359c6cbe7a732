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

/// Up to eight columns that are made from the eight numbers of an item, in the frame of any observer:
/// clip((own − its origin) · cos + (other − its origin) · sin, low, high), where `own` and `other` are two of these
/// numbers, by index. For a component of a vector they are both its components.
#[derive(Debug, Clone, Copy)]
pub(super) struct Group {
    own: [i32; LANES],
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
    own: [i32; LANES],
    other: [i32; LANES],
    cos: F32x8,
    sin: F32x8,
    low: F32x8,
    high: F32x8,
    origin: F32x8,
}

/// An index of numbers that are zero for all items.
pub(super) const ZERO: usize = 6;
const SIGN: u32 = 1 << 31;

impl Group {
    /// Columns that are +0, until they are set.
    pub(super) fn new() -> Self {
        let (zero, nothing) = (F32x8([0.0; LANES]), [ZERO as i32; LANES]);
        let (none, factor) = ([0; LANES], [0.0; LANES]);
        Self { own: nothing, other: nothing, rotated: none, sign: none, factor, low: zero, high: zero }
    }

    /// Makes a column a component of the vector whose components are the numbers `first` and `first + 1`.
    pub(super) fn set_vector(&mut self, lane: usize, first: usize, axis: Axis, column: &ObservationColumn) {
        (self.own[lane], self.other[lane]) = axis.own_and_other([first as i32, first as i32 + 1]);
        self.rotated[lane] = u32::MAX;
        self.sign[lane] = if axis == Axis::X { 0 } else { SIGN };
        self.scale(lane, column);
    }

    /// Makes a lane a component of a vector, the other component of which is in another lane: `own` is an index of the
    /// numbers of the origin. +0 without a column.
    pub(super) fn set_component(
        &mut self,
        lane: usize,
        [own, other]: [usize; 2],
        axis: Axis,
        column: Option<&ObservationColumn>,
    ) {
        (self.own[lane], self.other[lane]) = (own as i32, other as i32);
        self.rotated[lane] = u32::MAX;
        self.sign[lane] = if axis == Axis::X { 0 } else { SIGN };
        if let Some(column) = column {
            self.scale(lane, column);
        }
    }

    /// Makes a lane a number that is the same in every frame and has its scale already.
    pub(super) fn set_constant(&mut self, lane: usize) {
        self.other[lane] = lane as i32;
        (self.sign[lane], self.factor[lane]) = (SIGN, 1.0);
        (self.low.0[lane], self.high.0[lane]) = (Real::MIN, Real::MAX);
    }

    /// Whether a lane is a component of a vector.
    pub(super) fn turns(&self) -> bool {
        self.rotated != [0; LANES]
    }

    /// Makes a column one of the numbers.
    pub(super) fn set_number(&mut self, lane: usize, at: usize, column: &ObservationColumn) {
        self.own[lane] = at as i32;
        // −0 added to a number leaves its bits
        self.sign[lane] = SIGN;
        self.scale(lane, column);
    }

    /// Whether there is a column that was set.
    pub(super) fn moves(&self) -> bool {
        self.factor != [0.0; LANES]
    }

    fn scale(&mut self, lane: usize, column: &ObservationColumn) {
        self.factor[lane] = 1.0 / column.scale;
        (self.low.0[lane], self.high.0[lane]) = (column.low, column.high);
    }

    #[inline(always)]
    fn in_frame(&self, frame: &Frame, origin: &F32x8) -> RowTransform {
        let [cos, sin, one] = [frame.cos, frame.sin, 1.0].map(Real::to_bits);
        let cos = |i: usize| Real::from_bits(cos & self.rotated[i] | one & !self.rotated[i]) * self.factor[i];
        let sin = |i: usize| Real::from_bits(sin & self.rotated[i] ^ self.sign[i]) * self.factor[i];
        RowTransform {
            own: self.own,
            other: self.other,
            cos: F32x8(std::array::from_fn(cos)),
            sin: F32x8(std::array::from_fn(sin)),
            low: self.low,
            high: self.high,
            origin: *origin,
        }
    }

    /// For items whose numbers are in the order of the lanes.
    #[inline(always)]
    fn in_lanes(&self, frame: &Frame) -> RowTransform {
        let origin = F32x8(self.own.map(|own| [frame.x, frame.y].get(own as usize).copied().unwrap_or(0.0)));
        self.in_frame(frame, &origin)
    }
}

impl RowTransform {
    /// The columns of an item, and the numbers of `added` where these are +0.
    #[inline(always)]
    fn portable(&self, (item, added): (&F32x8, &F32x8)) -> [Real; LANES] {
        std::array::from_fn(|i| {
            let pick = |at: i32| item.0[at as usize % LANES] - self.origin.0[at as usize % LANES];
            let sum = pick(self.own[i]) * self.cos.0[i] + pick(self.other[i]) * self.sin.0[i];
            let rotated = clip(sum, self.low.0[i], self.high.0[i]);
            Real::from_bits(rotated.to_bits() | added.0[i].to_bits())
        })
    }

    /// [`Self::portable`] in one vector.
    #[cfg(target_arch = "x86_64")]
    #[inline]
    #[target_feature(enable = "avx2")]
    #[allow(unsafe_code, reason = "arrays and vectors of the same numbers are the same bytes")]
    fn avx2(&self, (item, added): (&F32x8, &F32x8)) -> [Real; LANES] {
        use std::arch::x86_64::*;
        // SAFETY: eight floats each
        let [item, added, origin]: [__m256; 3] = unsafe { std::mem::transmute([*item, *added, self.origin]) };
        // SAFETY: as above
        let [cos, sin, low, high]: [__m256; 4] =
            unsafe { std::mem::transmute([self.cos, self.sin, self.low, self.high]) };
        // SAFETY: eight numbers of 32 bits each
        let [own, other]: [__m256i; 2] = unsafe { std::mem::transmute([self.own, self.other]) };
        let item = _mm256_sub_ps(item, origin);
        let (v, w) = (_mm256_permutevar8x32_ps(item, own), _mm256_permutevar8x32_ps(item, other));
        let sum = _mm256_add_ps(_mm256_mul_ps(v, cos), _mm256_mul_ps(w, sin));
        let clipped = _mm256_min_ps(_mm256_max_ps(sum, low), high);
        // SAFETY: eight floats
        unsafe { std::mem::transmute(_mm256_or_ps(clipped, added)) }
    }

    /// The columns of an item whose numbers are in the order of the lanes.
    #[inline(always)]
    fn portable_lanes(&self, numbers: &F32x8) -> [Real; LANES] {
        let v: [Real; LANES] = std::array::from_fn(|i| numbers.0[i] - self.origin.0[i]);
        std::array::from_fn(|i| {
            let sum = v[i] * self.cos.0[i] + v[self.other[i] as usize % LANES] * self.sin.0[i];
            clip(sum, self.low.0[i], self.high.0[i])
        })
    }

    /// [`Self::portable_lanes`] in one vector.
    #[cfg(target_arch = "x86_64")]
    #[inline]
    #[target_feature(enable = "avx2")]
    #[allow(unsafe_code, reason = "arrays and vectors of the same numbers are the same bytes")]
    fn avx2_lanes(&self, numbers: &F32x8) -> [Real; LANES] {
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

/// Puts `G` times eight numbers for each index `width` numbers apart, of which `room` are its own, each eight from a first one
/// on. Where the output ends within those of an index, its own alone.
#[inline(always)]
fn put_each<const G: usize>(
    indices: &[u32],
    firsts: &[usize; G],
    width: usize,
    room: usize,
    out: &mut [Real],
    row: impl Fn(u32, usize) -> [Real; LANES],
) {
    let span = firsts.last().map_or(0, |first| first + LANES).min(G * LANES);
    let room = room.min(span);
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

simd_dispatch! {
    /// Fills the columns of some groups in the rows of agents, `width` numbers from row to row, of which `room` are theirs.
    /// `added` holds numbers for each agent. Of the `G` groups only the first `T` have columns that move.
    ///
    /// Fewer than eight columns in the last group leave something in the columns that follow them: the last columns are
    /// to be filled first.
    pub(super) fn fill_agents<G, T>(
        groups: &[&Group; G], frame: &Frame, origin: &F32x8, added: &[&[F32x8]; G], agents: &[F32x8], near: &[u32], width: usize, room: usize,
        out: &mut [Real],
    ) with transform [Fn(&RowTransform, (&F32x8, &F32x8)) -> [Real; LANES]] = RowTransform::portable, RowTransform::avx2 {
        let added = added.map(|added| &added[..agents.len()]);
        let transforms = groups.map(|group| group.in_frame(frame, origin));
        let firsts = std::array::from_fn(|g| g * LANES);
        put_each::<G>(near, &firsts, width, room, out, |agent_idx, g| {
            let agent_idx = agent_idx as usize;
            let (agent, added) = (&agents[agent_idx], &added[g][agent_idx]);
            if g < T { transform(&transforms[g], (agent, added)) } else { added.0 }
        });
    }

    /// Fills the columns of some groups in the rows of segments of the map, `width` numbers from row to row, each group from
    /// its first column on. `numbers` are those of each segment, lane by lane. Of the `G` groups only the first `T` move.
    pub(super) fn fill_segments<G, T>(
        groups: &[&Group; G], firsts: &[usize; G], frame: &Frame, numbers: &[F32x8], nearest: &[u32], width: usize, out: &mut [Real],
    ) with transform [Fn(&RowTransform, &F32x8) -> [Real; LANES]] = RowTransform::portable_lanes, RowTransform::avx2_lanes {
        let transforms = groups.map(|group| group.in_lanes(frame));
        let numbers = numbers.as_chunks::<G>().0;
        put_each::<G>(nearest, firsts, width, width, out, |k, g| {
            let numbers = &numbers[k as usize][g];
            if g < T { transform(&transforms[g], numbers) } else { numbers.0 }
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
            scale in prop::array::uniform8(1f32..100.0), added in prop::array::uniform8(0f32..1.0),
            at in prop::array::uniform8(0usize..7),
        ) {
            let frame = Frame::new(&Pose2::new(pose[0], pose[1], pose[2]));
            let mut group = Group::new();
            for lane in 0..LANES {
                let column = ObservationColumn {
                    name: "", unit: "", scale: scale[lane], low: -1.0, high: 1.0, doc: "", in_default: true,
                };
                match lane % 3 {
                    0 => group.set_vector(lane, at[lane], Axis::X, &column),
                    1 => group.set_vector(lane, at[lane], Axis::Y, &column),
                    _ => group.set_number(lane, at[lane], &column),
                }
            }
            let transform = group.in_frame(&frame, &F32x8([frame.x, frame.y, 0.0, 0.0, 1.5, -1.5, 0.0, 0.0]));
            if std::arch::is_x86_feature_detected!("avx2") {
                // SAFETY: just asked
                let wide = unsafe { transform.avx2((&F32x8(item), &F32x8(added))) };
                let portable = transform.portable((&F32x8(item), &F32x8(added)));
                prop_assert_eq!(wide.map(Real::to_bits), portable.map(Real::to_bits));
            }
        }
    }
}
