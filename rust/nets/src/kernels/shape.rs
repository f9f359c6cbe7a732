//! What a product of rows and columns reads and writes.

/// Columns of a panel of weights.
pub const PANEL: usize = 16;

/// Rows of `length` inputs times columns.
#[derive(Debug, Clone, Copy)]
pub(super) struct Product {
    pub(super) rows: usize,
    pub(super) length: usize,
    /// From one input to the next.
    pub(super) input_step: usize,
    pub(super) panels: usize,
    /// From one panel to the next.
    pub(super) panel_step: usize,
    /// From the weights of one input to those of the next.
    pub(super) weight_step: usize,
    /// From one row to the next, read and written.
    pub(super) from: usize,
    pub(super) to: usize,
    pub(super) relu: bool,
}

impl Product {
    /// Whether every number that is read or written lies within slices of these lengths; rows and panels are not none.
    pub(super) fn fits(&self, rows: usize, columns: usize, bias: Option<usize>, out: usize) -> bool {
        let farthest = || -> Option<[usize; 3]> {
            let (steps, last) = (self.length.checked_sub(1)?, self.rows.checked_sub(1)?);
            let input = last.checked_mul(self.from)?.checked_add(steps.checked_mul(self.input_step)?)?;
            let weight = (self.panels - 1).checked_mul(self.panel_step)?;
            let weight = weight.checked_add(steps.checked_mul(self.weight_step)?)?.checked_add(PANEL)?;
            let written = last.checked_mul(self.to)?.checked_add(self.panels.checked_mul(PANEL)?)?;
            Some([input.checked_add(1)?, weight, written])
        };
        farthest().is_some_and(|[input, weight, written]| {
            input <= rows
                && weight <= columns
                && written <= out
                && bias.is_none_or(|b| b >= self.panels * PANEL)
        })
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::sampling::noise::Noise;

    /// A plain product with random numbers of rows and weights.
    pub(in super::super) fn example(
        rows: usize,
        inputs: usize,
        panels: usize,
    ) -> (Product, Vec<f32>, Vec<f32>) {
        let p = Product {
            rows,
            length: inputs,
            input_step: 1,
            panels,
            panel_step: inputs * PANEL,
            weight_step: PANEL,
            from: inputs,
            to: panels * PANEL,
            relu: false,
        };
        (p, Noise::new(1, 1).normals(rows * inputs), Noise::new(2, 1).normals(panels * inputs * PANEL))
    }

    #[test]
    fn products_that_do_not_fit_are_known() {
        let (p, a, b) = example(5, 9, 3);
        let out = 5 * 3 * PANEL;
        assert!(p.fits(a.len(), b.len(), None, out));
        assert!(!p.fits(a.len() - 1, b.len(), None, out));
        assert!(!p.fits(a.len(), b.len() - 1, None, out));
        assert!(!p.fits(a.len(), b.len(), None, out - 1));
        assert!(!p.fits(a.len(), b.len(), Some(47), out));
        assert!(!Product { input_step: usize::MAX, ..p }.fits(a.len(), b.len(), None, out));
    }
}
