//! Gradients through decoders on the kernels of this crate.

use super::{Decoder, Pulls};
use crate::compute::backend::Backend;
use crate::compute::cpu::{Array, Cpu, Norm};
use crate::compute::layers::social::EdgeAwareLayer;
use crate::kernels::{Packed, Seen};
use crate::networks::trunk::Encoded;

/// The layers of a decoder, turned around.
#[derive(Debug)]
pub struct Back {
    layers: Vec<Packed>,
    /// What mixes latents, then query, key, value, out, own, both of the gate, and both of the feed of the social layer.
    joint: Option<[Packed; 10]>,
}

impl Pulls for Cpu {
    type Back = Back;

    fn turned(decoder: &Decoder<Cpu>) -> Back {
        let joint = decoder.joint.as_ref().map(|(mixed, l)| {
            let [up, down] = [&l.feed.0[0], &l.feed.0[1]];
            let (key, value) = (&l.key[0], &l.value[0]);
            [mixed, &l.query, key, value, &l.out, &l.own, &l.gate_in, &l.gate_own, up, down]
                .map(Packed::turned)
        });
        Back { layers: decoder.layers.0.iter().map(Packed::turned).collect(), joint }
    }

    fn pulled(
        decoder: &Decoder<Cpu>,
        back: &Back,
        seen: &Encoded<Cpu>,
        z: &Array,
        of_knots: &[f32],
    ) -> Vec<f32> {
        let joint = decoder.joint.as_ref().zip(back.joint.as_ref());
        let joint = joint.map(|((mixed, layer), back)| {
            let m = Cpu::apply(mixed, &Cpu::beside(&seen.token, z));
            let context = layer.forward(&m, &m, &seen.edges, &seen.slots).0;
            (m, context, layer, back)
        });
        let context = joint.as_ref().map_or(&seen.token, |(_, context, ..)| context);
        let mut made = vec![decoder.inputs(seen, z, context)];
        for layer in &decoder.layers.0[..decoder.layers.0.len() - 1] {
            made.push(Cpu::apply_relu(layer, &made[made.len() - 1]));
        }
        let mut gradient = Array::new(1, of_knots.len() / z.rows(), of_knots.to_vec());
        for (at, layer) in back.layers.iter().enumerate().rev() {
            gradient = Cpu::apply(layer, &gradient);
            if at > 0 {
                gradient = behind_relu(gradient, &made[at]);
            }
        }
        let (latent, width) = (z.width as i64, context.width as i64);
        let of_z = Cpu::columns(&gradient, 0, latent);
        let Some((m, _, layer, back)) = joint else { return of_z.numbers };
        let of_context = Cpu::columns(&gradient, latent, width);
        let of_m = through_social(layer, back, &m, seen, &of_context);
        let mixed = Cpu::apply(&back[0], &of_m);
        Cpu::sum(of_z, &Cpu::columns(&mixed, width, latent)).numbers
    }
}

/// Gradients in front of a ReLU.
fn behind_relu(gradient: Array, made: &Array) -> Array {
    each(&gradient, [made, made, made], |g, [y, ..]| if y > 0.0 { g } else { 0.0 })
}

/// A function of numbers in the same place.
fn each(a: &Array, others: [&Array; 3], of: impl Fn(f32, [f32; 3]) -> f32) -> Array {
    let [x, y, z] = others.map(|x| x.numbers.as_slice());
    let numbers = a.numbers.iter().enumerate().map(|(i, a)| of(*a, [x[i], y[i], z[i]]));
    Array::new(1, a.width, numbers.collect())
}

/// Gradients by the tokens of a layer that are its memory, too.
fn through_social(
    layer: &EdgeAwareLayer<Cpu>,
    [_, query, key, value, out, own_back, gate_in, gate_own, up, down]: &[Packed; 10],
    m: &Array,
    seen: &Encoded<Cpu>,
    gradient: &Array,
) -> Array {
    let q = Cpu::apply(&layer.query, &Cpu::normed(&layer.norm, m, false));
    let (keys, key_edges) = Cpu::apply_joint(&layer.key, m, &seen.edges);
    let (values, value_edges) = Cpu::apply_joint(&layer.value, m, &seen.edges);
    let (kv, edges) = ((keys, values), (key_edges, value_edges));
    let a = Cpu::apply(&layer.out, &Cpu::attend_across(&q, &kv, Some(&edges), &seen.slots, layer.heads).0);
    let (g, h) = (Cpu::apply(&layer.gate_in, &a), Cpu::apply(&layer.gate_own, m));
    let own = Cpu::apply(&layer.own, m);
    let gate = each(&g, [&h, &h, &h], |g, [h, ..]| (1.0 / (1.0 + libm::exp(-f64::from(g + h)))) as f32);
    let y = each(&a, [&gate, &own, &own], |a, [gate, own, _]| a + gate * (own - a));
    let hidden = Cpu::apply_relu(&layer.feed.0[0], &Cpu::normed(&layer.feed_norm, &y, false));

    let of_hidden = behind_relu(Cpu::apply(down, gradient), &hidden);
    let of_y = through_norm(&layer.feed_norm, &y, &Cpu::apply(up, &of_hidden));
    let of_y = Cpu::sum(of_y, gradient);
    let of_gate = each(&of_y, [&own, &a, &gate], |d, [own, a, gate]| d * (own - a) * gate * (1.0 - gate));
    let of_own = each(&of_y, [&gate, &gate, &gate], |d, [gate, ..]| d * gate);
    let of_a = each(&of_y, [&gate, &gate, &gate], |d, [gate, ..]| d * (1.0 - gate));
    let of_a = Cpu::sum(of_a, &Cpu::apply(gate_in, &of_gate));
    let [of_q, of_k, of_v] = through_attention(
        [&q, &kv.0, &kv.1, &edges.0, &edges.1].map(|x| x.numbers.as_slice()),
        &Cpu::apply(out, &of_a).numbers,
        &seen.slots.others,
        (q.width, layer.heads as usize),
    );
    let of_norm = through_norm(&layer.norm, m, &Cpu::apply(query, &of_q));
    let parts = [(gate_own, &of_gate), (own_back, &of_own), (key, &of_k), (value, &of_v)];
    parts.into_iter().fold(of_norm, |sum, (layer, of)| Cpu::sum(sum, &Cpu::apply(layer, of)))
}

/// Gradients by the rows of a layer norm.
fn through_norm(norm: &Norm, x: &Array, gradient: &Array) -> Array {
    let width = x.width;
    let mean = |numbers: &mut dyn Iterator<Item = f32>| numbers.sum::<f32>() / width as f32;
    let rows = x.numbers.chunks_exact(width).zip(gradient.numbers.chunks_exact(width));
    let mut numbers = Vec::with_capacity(x.numbers.len());
    for (x, gradient) in rows {
        let middle = mean(&mut x.iter().copied());
        let variance = mean(&mut x.iter().map(|x| (x - middle) * (x - middle)));
        let scale = 1.0 / (variance + 1e-5).sqrt();
        let weighted = || gradient.iter().zip(&norm.weight).map(|(g, w)| g * w);
        let normed = || x.iter().map(|x| (x - middle) * scale);
        let (shift, turn) = (mean(&mut weighted()), mean(&mut weighted().zip(normed()).map(|(g, x)| g * x)));
        numbers.extend(weighted().zip(normed()).map(|(g, x)| scale * (g - shift - x * turn)));
    }
    Array::new(1, width, numbers)
}

/// Gradients by queries, keys and values of rows from those of what attention gave them.
fn through_attention(
    [q, k, v, k_edge, v_edge]: [&[f32]; 5],
    gradient: &[f32],
    seen: &Seen,
    (width, heads): (usize, usize),
) -> [Array; 3] {
    let head = width / heads;
    let scale = 1.0 / (head as f32).sqrt();
    let mut of = [vec![0f32; q.len()], vec![0f32; q.len()], vec![0f32; q.len()]];
    for (row, pairs) in seen.start.windows(2).enumerate() {
        for from in (0..width).step_by(head) {
            let query = row * width + from;
            let places = || (pairs[0]..pairs[1]).map(|i| (seen.other[i] * width + from, i * width + from));
            let sum = |of: &dyn Fn(usize) -> f32| (0..head).map(of).sum::<f32>();
            let score = |(k_at, edge)| sum(&|c| q[query + c] * (k[k_at + c] + k_edge[edge + c])) * scale;
            let scores: Vec<f32> = places().map(score).collect();
            let most = scores.iter().fold(f32::NEG_INFINITY, |m, s| m.max(*s));
            let mut weights: Vec<f32> =
                scores.iter().map(|s| libm::exp(f64::from(s - most)) as f32).collect();
            let total: f32 = weights.iter().sum();
            weights.iter_mut().for_each(|w| *w /= total);
            let of_weight = |(v_at, edge)| sum(&|c| gradient[query + c] * (v[v_at + c] + v_edge[edge + c]));
            let of_weights: Vec<f32> = places().map(of_weight).collect();
            let shared: f32 = weights.iter().zip(&of_weights).map(|(w, d)| w * d).sum();
            for (((at, edge), w), d) in places().zip(&weights).zip(&of_weights) {
                let of_score = w * (d - shared) * scale;
                for c in 0..head {
                    of[0][query + c] += of_score * (k[at + c] + k_edge[edge + c]);
                    of[1][at + c] += of_score * q[query + c];
                    of[2][at + c] += w * gradient[query + c];
                }
            }
        }
    }
    of.map(|numbers| Array::new(1, width, numbers))
}
