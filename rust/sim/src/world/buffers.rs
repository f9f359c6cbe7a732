//! Where a step writes: memory of the caller, E worlds x C slots, row-major. One table names every array.

use crate::error::{Result, check_length};
use crate::observe::Layout;
use crate::world::config::{Autoreset, WorldConfig};
use crate::world::reward_columns::NUM_COLUMNS;

/// Sizes that every world's part of the arrays has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Extent {
    /// Slots C.
    pub slots: usize,
    /// Floats of an observation row D.
    pub row: usize,
    /// Channels, rows and columns of a raster; 0 without rasters.
    pub raster: [usize; 3],
    /// Whether the last observations of ended episodes are kept beside the first ones of the next.
    pub has_final: bool,
}

impl Extent {
    pub(crate) fn new(config: &WorldConfig, layout: &Layout) -> Self {
        Self {
            slots: config.num_slots,
            row: layout.size,
            raster: layout.bev.as_ref().map_or([0; 3], |bev| bev.shape),
            has_final: config.autoreset == Autoreset::SameStep,
        }
    }
}

/// An array of a step as callers make it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ArraySpec {
    /// Name.
    pub name: &'static str,
    /// Type of its elements, as numpy names it.
    pub dtype: &'static str,
    /// Shape for E worlds; empty where the configuration does not ask for it.
    pub shape: Vec<usize>,
}

/// Name in numpy of a type of elements.
fn dtype(name: &'static str) -> &'static str {
    match name {
        "f32" => "float32",
        "u8" => "uint8",
        _ => name,
    }
}

macro_rules! step_arrays {
    ($dollar:tt $extent:ident; $($(#[doc = $doc:literal])+ $name:ident: $type:ty, [$($axis:expr),*] $(, if $when:ident)?;)+) => {
        /// Output of a reset or a step. D is the size of the observation row, M the number of columns; arrays that the
        /// configuration does not ask for are empty.
        #[derive(Debug)]
        pub struct StepBuffers<'a> {
            $($(#[doc = $doc])+ pub $name: &'a mut [$type],)+
        }

        #[derive(Debug, Clone, Copy)]
        struct Sizes {
            $($name: usize,)+
        }

        impl Sizes {
            fn of($extent: Extent) -> Self {
                Self {
                    $($name: if true $(&& $extent.$when)? { 1 $(* $axis)* } else { 0 },)+
                }
            }
        }

        impl Extent {
            /// The arrays of E worlds, in the order of [`StepBuffers`].
            pub fn arrays(self, num_worlds: usize) -> Vec<ArraySpec> {
                let (sizes, $extent) = (Sizes::of(self), self);
                vec![$(ArraySpec {
                    name: stringify!($name),
                    dtype: dtype(stringify!($type)),
                    shape: if sizes.$name == 0 { vec![] } else { vec![num_worlds $(, $axis)*] },
                }),+]
            }
        }

        impl StepBuffers<'_> {
            /// Checks every length before anything is written.
            ///
            /// # Errors
            /// [`SimError::Length`] names the first array that does not fit.
            pub fn check(&self, num_worlds: usize, extent: Extent) -> Result<()> {
                let sizes = Sizes::of(extent);
                for (what, got, size) in [$((stringify!($name), self.$name.len(), sizes.$name)),+] {
                    check_length(what, got, num_worlds * size)?;
                }
                Ok(())
            }

            /// The same buffers for a call that takes them by value.
            pub(crate) fn reborrow(&mut self) -> StepBuffers<'_> {
                StepBuffers { $($name: self.$name),+ }
            }

            /// The part of one world.
            pub(crate) fn world(&mut self, i: usize, extent: Extent) -> StepBuffers<'_> {
                let sizes = Sizes::of(extent);
                StepBuffers { $($name: &mut self.$name[i * sizes.$name..(i + 1) * sizes.$name]),+ }
            }
        }

        impl<'a> StepBuffers<'a> {
            /// The buffers of the first `worlds` worlds, and those of the rest.
            pub(crate) fn split_at(self, worlds: usize, extent: Extent) -> (Self, Self) {
                let sizes = Sizes::of(extent);
                $(let $name = self.$name.split_at_mut(worlds * sizes.$name);)+
                (Self { $($name: $name.0),+ }, Self { $($name: $name.1),+ })
            }
        }

        /// Hands the list `name: type, …` of the arrays of a step to a macro.
        #[macro_export]
        macro_rules! with_step_arrays {
            ($dollar then:ident) => {
                $dollar then! { $($name: $type),+ }
            };
        }
    };
}

step_arrays! { $ extent;
    /// Observations [E, C, D]; zero for slots without a living agent.
    obs: f32, [extent.slots, extent.row];
    /// Rewards [E, C].
    reward: f32, [extent.slots];
    /// Whether an agent's episode ended in this step by what happened in it [E, C].
    terminated: bool, [extent.slots];
    /// Whether it was cut off in this step [E, C].
    truncated: bool, [extent.slots];
    /// Whether the slot's agent goes on after this step [E, C].
    alive: bool, [extent.slots];
    /// Info columns of the step [E, C, M], see [`super::COLUMNS`].
    columns: f32, [extent.slots, NUM_COLUMNS];
    /// Whether the world's episode ended in this step [E].
    done: bool, [];
    /// Whether the observation is the first of a new episode [E].
    was_reset: bool, [];
    /// In SAME_STEP mode the last observation of an ended episode [E, C, D].
    final_obs: f32, [extent.slots, extent.row], if has_final;
    /// Rasters [E, C, P, S, S]; zero where `obs` is.
    bev: u8, [extent.slots, extent.raster[0], extent.raster[1], extent.raster[2]];
    /// Rasters beside `final_obs` [E, C, P, S, S].
    final_bev: u8, [extent.slots, extent.raster[0], extent.raster[1], extent.raster[2]], if has_final;
}

impl StepBuffers<'_> {
    /// Rewards, endings and info columns of a step in which nothing happened.
    pub(crate) fn clear_step(&mut self) {
        self.reward.fill(0.0);
        self.terminated.fill(false);
        self.truncated.fill(false);
        self.columns.fill(0.0);
        self.done.fill(false);
    }
}
