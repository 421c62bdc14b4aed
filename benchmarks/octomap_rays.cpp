// Occlusion-aware entropy along rays in an OctoMap, the peer of bench_information.py.
//
//   octomap_rays MAP.ot RAYS COUNT RANGE LEAST REPEATS
//
// RAYS holds float32 origin and direction (x y z, x y z) of COUNT rays. Prints, per repeat, the
// seconds of processor time, and at the end the sum over all rays in bits.
#include <octomap/octomap.h>

#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <memory>
#include <vector>

int main(int argc, char** argv) {
  if (argc != 7) return 2;
  std::unique_ptr<octomap::AbstractOcTree> file(octomap::AbstractOcTree::read(argv[1]));
  auto* tree = dynamic_cast<octomap::OcTree*>(file.get());
  if (!tree) return 3;
  const size_t count = std::atol(argv[3]);
  const float range = std::atof(argv[4]), least = std::atof(argv[5]);
  std::vector<float> rays(6 * count);
  FILE* stream = std::fopen(argv[2], "rb");
  if (!stream || std::fread(rays.data(), sizeof(float), rays.size(), stream) != rays.size()) return 4;
  octomap::KeyRay keys;
  double sum = 0.0;
  for (int repeat = 0; repeat < std::atoi(argv[6]); ++repeat) {
    sum = 0.0;
    const std::clock_t start = std::clock();
    for (size_t n = 0; n < count; ++n) {
      const float* ray = &rays[6 * n];
      const octomap::point3d origin(ray[0], ray[1], ray[2]), direction(ray[3], ray[4], ray[5]);
      tree->computeRayKeys(origin, origin + direction * range, keys);
      double visible = 1.0;
      for (const octomap::OcTreeKey& key : keys) {
        const octomap::OcTreeNode* node = tree->search(key);
        const double p = node ? node->getOccupancy() : 0.5;
        if (p > 0.0 && p < 1.0) {
          sum -= visible * (p * std::log2(p) + (1.0 - p) * std::log2(1.0 - p));
        }
        if (p > 0.5) visible *= 1.0 - p;
        if (visible < least) break;
      }
    }
    std::printf("%.6f\n", double(std::clock() - start) / CLOCKS_PER_SEC);
  }
  std::printf("%.6f\n", sum);
  return 0;
}
