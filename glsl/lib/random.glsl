// lib/random.glsl -- counter-based random numbers: the same for a pixel, sample and dimension on every driver.
uint random_state;

// PCG hash: Jarzynski & Olano, "Hash Functions for GPU Rendering", JCGT 9(3) 2020.
uint pcg(uint v) {
    uint state = v * 747796405u + 2891336453u;
    uint word = ((state >> ((state >> 28u) + 4u)) ^ state) * 277803737u;
    return (word >> 22u) ^ word;
}

void random_seed(uvec2 px, uint sample_index, uint seed) {
    random_state = pcg(px.x ^ pcg(px.y ^ pcg(sample_index ^ pcg(seed))));
}

// In [0, 1): the 24 bits that a float holds exactly, so that 1 never appears.
float random_float() {
    random_state = pcg(random_state);
    return float(random_state >> 8u) * (1.0 / 16777216.0);
}

vec2 random_vec2() { float x = random_float(); return vec2(x, random_float()); }
