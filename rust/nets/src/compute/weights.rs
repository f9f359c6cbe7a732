//! Weight files: safetensors with one JSON header string. Nothing is unpickled, every name and shape is checked.

use crate::error::{ModelError, Result};
use crate::kernels::Packed;
use safetensors::tensor::{Dtype, SafeTensorError, SafeTensors};
use std::cell::RefCell;
use std::collections::{BTreeMap, BTreeSet};
use std::io::Read;
use std::ops::Range;
use std::path::{Path, PathBuf};
use xxhash_rust::xxh3::Xxh3;

/// Key of the JSON string in the file's metadata.
pub const HEADER: &str = "ccdiff_env";
/// Key in the header of what [`checksum`] gives; files without it are older.
pub const CHECKSUM: &str = "checksum";
/// Weight files are far smaller.
const MOST_BYTES: u64 = 1 << 30;
/// Version of the header's fields.
pub const FORMAT: u64 = 1;

/// A tensor of a file: its shape and its numbers.
pub type Entry = (Vec<usize>, Vec<f32>);
/// Header and tensors of a file.
pub type File = (serde_json::Value, BTreeMap<String, Entry>);

/// The error of a file that cannot be read or written.
pub fn io(path: &Path, action: &'static str) -> impl FnOnce(std::io::Error) -> ModelError {
    move |source| ModelError::Io { path: path.to_path_buf(), action, source }
}

/// The error of a file that does not hold what it should.
pub fn broken(path: &Path, entry: &str, got: impl Into<String>, expected: impl Into<String>) -> ModelError {
    ModelError::Checkpoint {
        path: path.to_path_buf(),
        entry: entry.to_string(),
        got: got.into(),
        expected: expected.into(),
    }
}

/// A hash of names and values, against damage, not against forgers.
pub fn checksum<'a>(tensors: impl Iterator<Item = (&'a str, &'a [u8])>) -> String {
    let mut hash = Xxh3::new();
    for (name, bytes) in tensors {
        hash.update(name.as_bytes());
        hash.update(bytes);
    }
    format!("{:032x}", hash.digest128())
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
pub fn read(path: &Path) -> Result<File> {
    parse(path, &bytes_of(path)?)
}

/// Header and tensors of a file's bytes; errors name the path.
///
/// # Errors
/// [`ModelError::Checkpoint`] where these are not the bytes of such a file.
pub fn parse(path: &Path, bytes: &[u8]) -> Result<File> {
    let (_, metadata) = SafeTensors::read_metadata(bytes).map_err(foreign(path))?;
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
    let file = SafeTensors::deserialize(bytes).map_err(foreign(path))?;
    let views: BTreeMap<_, _> = file.tensors().into_iter().collect();
    let found = checksum(views.iter().map(|(name, view)| (name.as_str(), view.data())));
    match header.get(CHECKSUM) {
        Some(expected) if *expected != found => {
            return Err(broken(path, CHECKSUM, found, expected.to_string()));
        }
        _ => {}
    }
    Ok((header, tensors(path, bytes)?))
}

fn foreign(path: &Path) -> impl Fn(SafeTensorError) -> ModelError {
    move |e| broken(path, "file", format!("not a safetensors file ({e})"), "one that training wrote")
}

/// The tensors of a file's bytes, whatever its header; errors name the path.
///
/// # Errors
/// [`ModelError::Checkpoint`] for another kind of file, and for numbers that are none.
pub fn tensors(path: &Path, bytes: &[u8]) -> Result<BTreeMap<String, Entry>> {
    let file = SafeTensors::deserialize(bytes).map_err(foreign(path))?;
    let mut tensors = BTreeMap::new();
    for (name, view) in file.tensors().into_iter().collect::<BTreeMap<_, _>>() {
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
        tensors.insert(name, (view.shape().to_vec(), values));
    }
    Ok(tensors)
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

/// The tensors of a file as a network takes them. What does not fit is kept as the error of [`Self::finish`]: until then the
/// network is as good as none.
#[derive(Debug)]
pub struct Weights {
    path: PathBuf,
    tensors: BTreeMap<String, Entry>,
    taken: RefCell<BTreeSet<String>>,
    wrong: RefCell<Option<ModelError>>,
}

impl Weights {
    /// The tensors of a file.
    pub fn new(path: &Path, tensors: BTreeMap<String, Entry>) -> Self {
        Self {
            path: path.to_path_buf(),
            tensors,
            taken: RefCell::new(BTreeSet::new()),
            wrong: RefCell::new(None),
        }
    }

    /// The numbers of a tensor of this shape; `None` where there is none.
    pub fn take(&self, name: &str, shape: &[usize]) -> Option<&[f32]> {
        self.taken.borrow_mut().insert(name.to_owned());
        let wrong = match self.tensors.get(name) {
            Some((found, numbers)) if found == shape => return Some(numbers),
            Some((found, _)) => broken(&self.path, name, format!("{found:?}"), format!("{shape:?}")),
            None => broken(&self.path, name, "missing", format!("{shape:?}")),
        };
        self.wrong.borrow_mut().get_or_insert(wrong);
        None
    }

    /// The linear layer of a name.
    pub(crate) fn layer(&self, name: &str, inputs: usize, outputs: usize) -> Packed {
        self.columns(name, (inputs, outputs), 0..inputs, true)
    }

    /// Some columns of a linear layer of (inputs, outputs); none of one that is not there.
    pub(crate) fn columns(
        &self,
        name: &str,
        (inputs, outputs): (usize, usize),
        part: Range<usize>,
        biased: bool,
    ) -> Packed {
        let rows = self.take(&format!("{name}.weight"), &[outputs, inputs]);
        let bias = biased.then(|| self.take(&format!("{name}.bias"), &[outputs])).flatten();
        let Some(rows) = rows else { return Packed::new(&[], &[], 0, 0) };
        let columns = rows.chunks_exact(inputs.max(1)).flat_map(|row| &row[part.clone()]).copied();
        Packed::new(&columns.collect::<Vec<_>>(), bias.unwrap_or_default(), outputs, part.len())
    }

    /// Checks that all that was taken was there, and that nothing is left.
    ///
    /// # Errors
    /// [`ModelError::Checkpoint`] names the first tensor that is missing, of another shape or left over.
    pub fn finish(self) -> Result<()> {
        let taken = self.taken.into_inner();
        match (self.wrong.into_inner(), self.tensors.keys().find(|name| !taken.contains(*name))) {
            (Some(wrong), _) => Err(wrong),
            (None, Some(name)) => {
                Err(broken(&self.path, name, "an unknown tensor", "only the network's own"))
            }
            (None, None) => Ok(()),
        }
    }
}
