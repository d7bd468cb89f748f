#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| vlf_fuzz::guarded(vlf_fuzz::gltf, data));
