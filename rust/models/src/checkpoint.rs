//! Weight files and the variables of networks on torch; what the files hold is in [`ccdiff_nets::compute::weights`].

pub use ccdiff_nets::compute::weights::field;

use crate::error::Result;
use crate::torch::to_vec;
use ccdiff_nets::compute::weights::{self, CHECKSUM, Entry, FORMAT, HEADER, broken, checksum, io};
use safetensors::tensor::{Dtype, TensorView, serialize};
use std::collections::BTreeMap;
use std::path::Path;
use tch::{Kind, Tensor, nn};

/// All variables of a store by name, in a fixed order.
pub(crate) fn variables(store: &nn::VarStore) -> BTreeMap<String, Tensor> {
    store.variables().into_iter().collect()
}

/// Writes f32 tensors and a header, an object. The file appears whole or not at all.
///
/// # Errors
/// [`ModelError::Io`] where it cannot be written.
pub fn write(path: &Path, header: &serde_json::Value, tensors: &BTreeMap<String, Tensor>) -> Result<()> {
    let mut data = BTreeMap::new();
    for (name, tensor) in tensors {
        let values = to_vec(&tensor.to_kind(Kind::Float));
        if let Some(value) = values.iter().find(|v| !v.is_finite()) {
            return Err(broken(path, name, value.to_string(), "finite numbers"));
        }
        let bytes: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        let shape: Vec<usize> = tensor.size().iter().map(|s| *s as usize).collect();
        data.insert(name.as_str(), (shape, bytes));
    }
    let views = data
        .iter()
        .map(|(name, (shape, bytes))| Ok((*name, TensorView::new(Dtype::F32, shape.clone(), bytes)?)))
        .collect::<std::result::Result<Vec<_>, safetensors::SafeTensorError>>()
        .map_err(|e| broken(path, "tensors", e.to_string(), "consistent sizes"))?;
    let mut header = header.clone();
    header["format"] = FORMAT.into();
    header[CHECKSUM] = checksum(data.iter().map(|(name, (_, bytes))| (*name, bytes.as_slice()))).into();
    let metadata = Some([(HEADER.to_string(), header.to_string())].into_iter().collect());
    let bytes = serialize(views, &metadata)
        .map_err(|e| broken(path, "tensors", e.to_string(), "serialisable tensors"))?;
    let temporary = path.with_extension("safetensors.part");
    let written = std::fs::write(&temporary, bytes)
        .map_err(io(path, "cannot write"))
        .and_then(|()| std::fs::rename(&temporary, path).map_err(io(path, "cannot rename into place")));
    if written.is_err() {
        // best effort: half a file is never read
        let _ = std::fs::remove_file(&temporary);
    }
    written
}

/// Reads the header and all tensors of a file.
///
/// # Errors
/// As [`weights::read`].
pub fn read(path: &Path) -> Result<(serde_json::Value, BTreeMap<String, Tensor>)> {
    let (header, entries) = weights::read(path)?;
    Ok((header, tensors(&entries)))
}

/// The tensors of a file.
pub(crate) fn tensors(entries: &BTreeMap<String, Entry>) -> BTreeMap<String, Tensor> {
    let tensor = |(name, (shape, numbers)): (&String, &Entry)| {
        let shape: Vec<i64> = shape.iter().map(|s| *s as i64).collect();
        (name.clone(), Tensor::from_slice(numbers).view(shape.as_slice()))
    };
    entries.iter().map(tensor).collect()
}

/// Copies tensors into variables; both sides must have the same names and shapes.
///
/// # Errors
/// [`ModelError::Checkpoint`] names the first tensor that is missing, left over or of another shape.
pub fn fill(
    path: &Path,
    tensors: &BTreeMap<String, Tensor>,
    variables: &mut BTreeMap<String, Tensor>,
) -> Result<()> {
    for (name, variable) in variables.iter_mut() {
        let want = format!("{:?}", variable.size());
        let found = tensors.get(name).ok_or_else(|| broken(path, name, "missing", &want))?;
        if found.size() != variable.size() {
            return Err(broken(path, name, format!("{:?}", found.size()), want));
        }
        tch::no_grad(|| variable.copy_(found));
    }
    match tensors.keys().find(|name| !variables.contains_key(*name)) {
        Some(name) => Err(broken(path, name, "an unknown tensor", "only the network's own")),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::error::ModelError;

    fn variables(value: f64) -> BTreeMap<String, Tensor> {
        let full = |size: &[i64]| Tensor::full(size, value, (Kind::Float, tch::Device::Cpu));
        [("a".to_string(), full(&[2, 3])), ("b.c".to_string(), full(&[4]))].into_iter().collect()
    }

    #[test]
    fn weights_come_back_and_wrong_ones_are_refused_by_name() {
        let dir = std::env::temp_dir().join(format!("ccdiff-checkpoint-{}", std::process::id()));
        std::fs::create_dir_all(&dir).unwrap();
        let path = dir.join("w.safetensors");
        write(&path, &serde_json::json!({"step": 7}), &variables(3.5)).unwrap();
        let (header, tensors) = read(&path).unwrap();
        assert_eq!(field::<u64>(&path, &header, "step").unwrap(), 7);
        assert!(field::<u64>(&path, &header, "steps").unwrap_err().to_string().contains("steps"));
        let mut into = variables(0.0);
        fill(&path, &tensors, &mut into).unwrap();
        assert_eq!(into["a"].double_value(&[1, 2]), 3.5);
        let mut other = variables(0.0);
        other.insert("a".into(), Tensor::zeros([3, 2], (Kind::Float, tch::Device::Cpu)));
        let text = fill(&path, &tensors, &mut other).unwrap_err().to_string();
        assert!(text.contains("[2, 3]") && text.contains("[3, 2]"), "{text}");
        other.remove("a");
        assert!(fill(&path, &tensors, &mut other).unwrap_err().to_string().contains("unknown"));
        // a file from before there were checksums
        let (key, mut bytes) = (b"checksum", std::fs::read(&path).unwrap());
        let at = bytes.windows(key.len()).position(|part| part == key).unwrap();
        bytes[at..at + key.len()].copy_from_slice(b"elsewise");
        std::fs::write(&path, &bytes).unwrap();
        assert!(read(&path).is_ok());
        // what is no file is not read, and what cannot be put in place leaves nothing
        let folder = dir.join("folder.safetensors");
        std::fs::create_dir(&folder).unwrap();
        assert!(matches!(read(&folder), Err(ModelError::Checkpoint { .. })));
        assert!(write(&folder, &serde_json::json!({}), &variables(1.0)).is_err());
        assert!(!dir.join("folder.safetensors.part").exists());
        std::fs::remove_dir_all(&dir).unwrap();
        assert!(matches!(read(&path), Err(ModelError::Io { .. })));
    }
}
