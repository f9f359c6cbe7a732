//! Scenes as bytes, and their content hash.

use crate::error::{NuscenesError, Result};
use ccdiff_sim::scene::Scene;
use xxhash_rust::xxh3::xxh3_128;

/// What scene bytes begin with; the last byte is the format's number.
const MARK: &[u8; 9] = b"ccdscene\x04";

/// A scene as a mark and postcard bytes: the same for equal scenes, on every machine.
///
/// # Errors
/// [`NuscenesError::Bytes`] where the encoder refuses, which it does not for scenes that are valid.
pub fn encode_scene(scene: &Scene) -> Result<Vec<u8>> {
    Ok([MARK, contents(scene)?.as_slice()].concat())
}

fn contents(scene: &Scene) -> Result<Vec<u8>> {
    postcard::to_stdvec(scene).map_err(|e| NuscenesError::Bytes(e.to_string()))
}

/// The scene that [`encode_scene`] wrote.
///
/// # Errors
/// [`NuscenesError::Bytes`] for bytes that are no scene, [`NuscenesError::Scene`] for one that breaks a rule.
pub fn decode_scene(bytes: &[u8]) -> Result<Scene> {
    let Some(contents) = bytes.strip_prefix(MARK) else {
        let message = "not of format 4: load the scene from its data set, or record it, again";
        return Err(NuscenesError::Bytes(message.into()));
    };
    let scene: Scene = postcard::from_bytes(contents).map_err(|e| NuscenesError::Bytes(e.to_string()))?;
    Ok(scene.validated()?)
}

/// Hash of everything in a scene, 32 hexadecimal digits; the same on every machine. Tells scenes apart, does not
/// protect against forgery.
///
/// # Errors
/// As [`encode_scene`].
pub fn scene_hash(scene: &Scene) -> Result<String> {
    Ok(format!("{:032x}", xxh3_128(&contents(scene)?)))
}
