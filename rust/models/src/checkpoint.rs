//! Weight files: safetensors with one JSON header string. Nothing is unpickled, every name and shape is checked.

use crate::error::{ModelError, Result};
use safetensors::tensor::{Dtype, SafeTensors, TensorView, serialize};
use std::collections::BTreeMap;
use std::io::Read;
use std::path::Path;
use tch::{Kind, Tensor};
use xxhash_rust::xxh3::Xxh3;

/// Key of the JSON string in the file's metadata.
const HEADER: &str = "ccdiff_env";
/// Key in the header of what [`checksum`] gives; files without it are older.
const CHECKSUM: &str = "checksum";

fn io(path: &Path, action: &'static str) -> impl FnOnce(std::io::Error) -> ModelError {
    move |source| ModelError::Io { path: path.to_path_buf(), action, source }
}

fn broken(path: &Path, entry: &str, got: impl Into<String>, expected: impl Into<String>) -> ModelError {
    ModelError::Checkpoint {
        path: path.to_path_buf(),
        entry: entry.to_string(),
        got: got.into(),
        expected: expected.into(),
    }
}

/// Weight files are far smaller.
const MOST_BYTES: u64 = 1 << 30;
/// Version of the header's fields.
const FORMAT: u64 = 1;

/// A hash of names and values, against damage, not against forgers.
fn checksum<'a>(tensors: impl Iterator<Item = (&'a str, &'a [u8])>) -> String {
    let mut hash = Xxh3::new();
    for (name, bytes) in tensors {
        hash.update(name.as_bytes());
        hash.update(bytes);
    }
    format!("{:032x}", hash.digest128())
}

/// Writes f32 tensors and a header, an object. The file appears whole or not at all.
///
/// # Errors
/// [`ModelError::Io`] where it cannot be written.
pub fn write(path: &Path, header: &serde_json::Value, tensors: &BTreeMap<String, Tensor>) -> Result<()> {
    let mut data = BTreeMap::new();
    for (name, tensor) in tensors {
        let flat = tensor.to_device(tch::Device::Cpu).to_kind(Kind::Float).contiguous();
        let count = flat.numel();
        let mut values = vec![0f32; count];
        flat.view([-1]).copy_data(&mut values, count);
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

/// The bytes of a regular file of a bounded size: what else a folder may hold blocks its reader, or has no end.
fn bytes_of(path: &Path) -> Result<Vec<u8>> {
    let found = std::fs::metadata(path).map_err(io(path, "cannot read"))?;
    if !found.is_file() || found.len() > MOST_BYTES {
        let got = format!("{} bytes, a regular file: {}", found.len(), found.is_file());
        return Err(broken(path, "file", got, "a regular file of at most 1 GiB"));
    }
    let mut bytes = Vec::new();
    let file = std::fs::File::open(path).map_err(io(path, "cannot read"))?;
    file.take(MOST_BYTES).read_to_end(&mut bytes).map_err(io(path, "cannot read"))?;
    Ok(bytes)
}

/// Reads the header and all tensors of a file.
///
/// # Errors
/// [`ModelError::Io`] where it cannot be read, [`ModelError::Checkpoint`] where it is not such a file.
pub fn read(path: &Path) -> Result<(serde_json::Value, BTreeMap<String, Tensor>)> {
    let bytes = bytes_of(path)?;
    let foreign = |e: safetensors::SafeTensorError| {
        broken(path, "file", format!("not a safetensors file ({e})"), "one that training wrote")
    };
    let (_, metadata) = SafeTensors::read_metadata(&bytes).map_err(foreign)?;
    let text = metadata
        .metadata()
        .as_ref()
        .and_then(|m| m.get(HEADER))
        .ok_or_else(|| broken(path, "header", "missing", format!("metadata key {HEADER:?}")))?;
    let header: serde_json::Value =
        serde_json::from_str(text).map_err(|e| broken(path, "header", e.to_string(), "a JSON object"))?;
    if header["format"] != FORMAT {
        return Err(broken(path, "format", header["format"].to_string(), FORMAT.to_string()));
    }
    let file = SafeTensors::deserialize(&bytes).map_err(foreign)?;
    let views: BTreeMap<_, _> = file.tensors().into_iter().collect();
    let found = checksum(views.iter().map(|(name, view)| (name.as_str(), view.data())));
    match header.get(CHECKSUM) {
        Some(expected) if *expected != found => {
            return Err(broken(path, CHECKSUM, found, expected.to_string()));
        }
        _ => {}
    }
    let mut tensors = BTreeMap::new();
    for (name, view) in views {
        if view.dtype() != Dtype::F32 {
            return Err(broken(path, &name, format!("{:?}", view.dtype()), "F32"));
        }
        let values: Vec<f32> =
            view.data().chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect();
        if let Some(value) = values.iter().find(|v| !v.is_finite()) {
            return Err(broken(path, &name, value.to_string(), "finite numbers"));
        }
        if view.shape().iter().any(|size| *size > values.len()) {
            return Err(broken(path, &name, format!("of shape {:?}", view.shape()), "a number at least"));
        }
        let shape: Vec<i64> = view.shape().iter().map(|s| *s as i64).collect();
        tensors.insert(name, Tensor::from_slice(&values).view(shape.as_slice()));
    }
    Ok((header, tensors))
}

/// A field of the header.
///
/// # Errors
/// [`ModelError::Checkpoint`] where it is missing or of another kind.
pub fn field<T: serde::de::DeserializeOwned>(
    path: &Path,
    header: &serde_json::Value,
    name: &str,
) -> Result<T> {
    let value = header.get(name).cloned().unwrap_or_default();
    serde_json::from_value(value).map_err(|e| broken(path, name, e.to_string(), "as written by this code"))
}

/// Copies `prefix`-named tensors into variables; both sides must have the same names and shapes.
///
/// # Errors
/// [`ModelError::Checkpoint`] names the first tensor that is missing, left over or of another shape.
pub fn fill(
    path: &Path,
    tensors: &BTreeMap<String, Tensor>,
    prefix: &str,
    variables: &mut BTreeMap<String, Tensor>,
) -> Result<()> {
    for (name, variable) in variables.iter_mut() {
        let full = format!("{prefix}{name}");
        let want = format!("{:?}", variable.size());
        let found = tensors.get(&full).ok_or_else(|| broken(path, &full, "missing", &want))?;
        if found.size() != variable.size() {
            return Err(broken(path, &full, format!("{:?}", found.size()), want));
        }
        tch::no_grad(|| variable.copy_(found));
    }
    let extra = tensors.keys().find(|k| k.strip_prefix(prefix).is_some_and(|n| !variables.contains_key(n)));
    match extra {
        Some(name) => Err(broken(path, name, "an unknown tensor", "only the network's own")),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
        fill(&path, &tensors, "", &mut into).unwrap();
        assert_eq!(into["a"].double_value(&[1, 2]), 3.5);
        let mut other = variables(0.0);
        other.insert("a".into(), Tensor::zeros([3, 2], (Kind::Float, tch::Device::Cpu)));
        let text = fill(&path, &tensors, "", &mut other).unwrap_err().to_string();
        assert!(text.contains("[2, 3]") && text.contains("[3, 2]"), "{text}");
        other.remove("a");
        assert!(fill(&path, &tensors, "", &mut other).unwrap_err().to_string().contains("unknown"));
        // one flipped bit of one number
        let whole = std::fs::read(&path).unwrap();
        let mut bytes = whole.clone();
        *bytes.last_mut().unwrap() ^= 1;
        std::fs::write(&path, &bytes).unwrap();
        let text = read(&path).unwrap_err().to_string();
        assert!(text.contains("checksum"), "{text}");
        // a file from before there were checksums
        let key = b"checksum";
        let at = whole.windows(key.len()).position(|part| part == key).unwrap();
        let mut bytes = whole.clone();
        bytes[at..at + key.len()].copy_from_slice(b"elsewise");
        std::fs::write(&path, &bytes).unwrap();
        assert!(read(&path).is_ok());
        std::fs::write(&path, b"not a tensor file").unwrap();
        assert!(matches!(read(&path), Err(ModelError::Checkpoint { .. })));
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
