//! Scenes as bytes, and their content hash.

use crate::error::{NuscenesError, Result};
use ccdiff_sim::scene::{Light, Scene};
use std::sync::Arc;
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
    let bytes = postcard::to_stdvec(scene);
    let bytes = match scene.map.lights.is_empty() {
        true => bytes,
        false => bytes.and_then(|bytes| postcard::to_extend(&scene.map.lights, bytes)),
    };
    bytes.map_err(|e| NuscenesError::Bytes(e.to_string()))
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
    let fault = |e: postcard::Error| NuscenesError::Bytes(e.to_string());
    let (mut scene, rest) = postcard::take_from_bytes::<Scene>(contents).map_err(fault)?;
    if !rest.is_empty() {
        let (lights, rest) = postcard::take_from_bytes::<Vec<Light>>(rest).map_err(fault)?;
        if lights.is_empty() || !rest.is_empty() {
            return Err(NuscenesError::Bytes("bytes after the end".into()));
        }
        Arc::make_mut(&mut scene.map).lights = lights;
    }
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
