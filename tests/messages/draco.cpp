// Encodes points with Draco as the plugin draco of point_cloud_transport does: an attribute for each field, in their
// order. Reads 16-byte points (x, y, z: float32, then ring: uint16, tag: uint8, and a byte of padding) from stdin, writes
// the compressed data to stdout. Arguments: deduplicate (0 or 1), bits of positions (0: not rounded), method (0, 1, 2).
#include <cstdio>
#include <cstdlib>
#include <iterator>
#include <iostream>
#include <vector>

#include <draco/compression/encode.h>
#include <draco/point_cloud/point_cloud_builder.h>

int main(int, char **given) {
  std::vector<char> data((std::istreambuf_iterator<char>(std::cin)), {});
  const int step = 16, bits = std::atoi(given[2]), method = std::atoi(given[3]);
  draco::PointCloudBuilder builder;
  builder.Start(data.size() / step);
  const auto generic = draco::GeometryAttribute::GENERIC, position = draco::GeometryAttribute::POSITION;
  const int offsets[] = {0, 4, 8, 12, 14};
  const draco::DataType kinds[] = {draco::DT_FLOAT32, draco::DT_FLOAT32, draco::DT_FLOAT32, draco::DT_UINT16, draco::DT_UINT8};
  for (int field = 0; field < 5; field++) {
    const int id = builder.AddAttribute(field < 3 ? position : generic, 1, kinds[field]);
    builder.SetAttributeValuesForAllPoints(id, data.data() + offsets[field], step);
  }
  auto cloud = builder.Finalize(std::atoi(given[1]) != 0);
  auto metadata = std::make_unique<draco::GeometryMetadata>();
  metadata->AddEntryInt("deduplicate", std::atoi(given[1]));
  cloud->AddMetadata(std::move(metadata));
  draco::Encoder encoder;
  encoder.SetSpeedOptions(7, 7);
  if (bits) encoder.SetAttributeQuantization(position, bits);
  if (method == 1) encoder.SetEncodingMethod(draco::POINT_CLOUD_KD_TREE_ENCODING);
  if (method == 2) encoder.SetEncodingMethod(draco::POINT_CLOUD_SEQUENTIAL_ENCODING);
  draco::EncoderBuffer buffer;
  const auto status = encoder.EncodePointCloudToBuffer(*cloud, &buffer);
  if (!status.ok()) { std::cerr << status.error_msg_string() << "\n"; return 1; }
  std::fwrite(buffer.data(), 1, buffer.size(), stdout);
  std::cerr << cloud->num_points() << "\n";
}
